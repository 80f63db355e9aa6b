"""Every reader and importer, fed with damaged copies of valid files: an error that names the file, or a result; never anything else.

`make fuzz` tries for longer: KINEGRAPH_FUZZ_S seconds a format, with other seeds every day.
"""

from __future__ import annotations

import datetime
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import edfio
import numpy as np
import pytest
import scipy.io

from kinegraph.stream.errors import KinegraphError
from tests.files import lab_replicas
from tests.support.command_line import succeeding
from tests.support.measured import MOST_S
from tests.support.mutants import SECONDS, mutant, seed_of

MUTANTS = 25
"""As many are tried of each format where no time is given: the same ones every time."""

RECORDED = edfio.Recording(startdate=datetime.date(2024, 5, 1))
Reader = Callable[[Path], object]

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Knee
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0333333
0 90 0 0 0 0 1 2 3
1 90 0 0 0 0 2 3 4
2 90 0 0 0 0 3 4 5
"""
ASF = """:version 1.10
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name lfemur
    direction 0.3 -0.9 0
    length 7.2
    axis 0 0 20 XYZ
    dof rx ry rz
  end
:hierarchy
  begin
    root lfemur
  end
"""
AMC = ":FULLY-SPECIFIED\n:DEGREES\n" + "".join(f"{k}\nroot 0 17 {k} 0 1 2\nlfemur 1 2 {k}\n" for k in range(1, 5))
KINECT = "".join(f"{k / 30:.4f} " + " ".join(f"{0.1 * j + k:.3f}" for j in range(60)) + "\n" for k in range(5))
KINECT_NAMED = "time;A_x;A_y;A_z;B_x;B_y;B_z;B_state\n" + "".join(f"{k / 30:.4f};1,5;2;3;4;5;6;2\n" for k in range(5))
CSV = "time [s],a [uV],b [uV]\n" + "".join(f"{k / 100},{k},{-k / 7:.5f}\n" for k in range(30))
HYPNOGRAM = "onset,duration,stage\n" + "".join(f"2024-05-01T22:{k:02d}:00Z,30,N{k % 3 + 1}\n" for k in range(40))
TRUTH = "start_s,end_s,label,repetitions\n" + "".join(f"{k},{k + 0.9},walk,{k}\n" for k in range(20))


def importing(*options: str) -> Reader:
    """The command itself, as a user calls it."""

    def read(path: Path) -> None:
        from kinegraph.stream.cli.main import call

        files = [path] if path.suffix != ".amc" else [path, path.with_suffix(".asf")]
        try:
            call("files import", [*map(str, files), "-o", str(path.parent / "out.mcap"), "--overwrite", *options])
        except SystemExit as end:
            assert end.code in (0, None)

    return read


def hypnogram(path: Path) -> None:
    from kinegraph.operators.sleep.evaluation.reference import read_hypnogram

    read_hypnogram(path)


def truth(path: Path) -> None:
    from kinegraph.operators.segmentation.evaluation.truth import read_truth

    read_truth(path)


def recording(path: Path) -> None:
    """Everything that `info`, `export`, `recover` and `replay` read of one."""
    import json

    from kinegraph.stream.cli.commands.info import facts
    from kinegraph.stream.recording import Recording
    from kinegraph.stream.recording.recover import rewrite

    out = path.with_name("recovered.mcap")
    out.unlink(missing_ok=True)
    try:
        with Recording.open(path) as opened:
            json.dumps(facts(opened))
            list(opened.inputs())
            for name, stream in opened.streams.items():
                if stream.kept != "outline":
                    opened.read(name)
    except KinegraphError:
        rewrite(path, out)
        with Recording.open(out) as opened:
            list(opened.inputs())


def checkpoint(path: Path) -> None:
    from kinegraph.stream.recording.format.checkpoint import NAME, Checkpoint

    path.replace(path.with_name(NAME))
    Checkpoint.load(path.parent)


def report(path: Path) -> None:
    from kinegraph.devices.reports.session.contents.data import load

    load(path)


def night(path: Path) -> None:
    from kinegraph.devices.reports.night import archive

    folder = path.parent / "nights" / "2024-05-01"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / archive.FACTS).write_text('{"version": 1, "name": "x", "begun": 0, "epoch_s": 30.0}')
    path.replace(folder / archive.EPOCHS)
    archive.read_epochs(folder)


def seeds(folder: Path, made: Path) -> dict[str, tuple[bytes, Reader]]:
    """A valid file of each format by the name that it goes by, and its reader."""
    from kinegraph.stream.recording.format.checkpoint import NAME, Checkpoint

    np.savez(
        folder / "x.npz", emg=np.arange(60.0).reshape(20, 3), time=np.arange(20) / 100, names=np.array(["a", "b", "c"])
    )
    np.savez_compressed(folder / "y.npz", emg=np.arange(60.0), rate=np.array(100.0))
    np.savez(
        folder / "truth.npz", label=np.repeat([0, -1, 1], 20), rate=np.array(30.0), label_names=np.array(["a", "b"])
    )
    Checkpoint(5, 7, "x", {"a": 1}, {}, {"a/z": np.arange(12.0), "a/n": np.array(3)}).save(folder)
    from kinegraph.stream.cli.main import call

    for suffix in ("xdf",):
        with succeeding():
            call("files export", [str(made / "s"), "-o", str(folder / f"x.{suffix}")])
    from kinegraph.stream.recording.format.paths import parts_of

    table = ["--stream", "emg=emg", "--rate", "emg=100"]
    found = {
        "walk.bvh": (BVH.encode(), importing()),
        "walk.amc": (AMC.encode(), importing()),
        "walk.asf": (ASF.encode(), importing_skeleton),
        "kinect.csv": (KINECT.encode(), importing("--kinect")),
        "named.csv": (KINECT_NAMED.encode(), importing("--kinect")),
        "emg.csv": (CSV.encode(), importing()),
        "x.npz": ((folder / "x.npz").read_bytes(), importing(*table)),
        "y.npz": ((folder / "y.npz").read_bytes(), importing(*table)),
        "x.xdf": ((folder / "x.xdf").read_bytes(), importing()),
        "x.mcap": (parts_of(made / "s")[0].read_bytes(), recording),
        "hypnogram.csv": (HYPNOGRAM.encode(), hypnogram),
        "truth.csv": (TRUTH.encode(), truth),
        "truth.npz": ((folder / "truth.npz").read_bytes(), truth),
        "checkpoint.bin": ((folder / NAME).read_bytes(), checkpoint),
        "epochs.csv": (EPOCHS.encode(), night),
    }
    found |= {f"lab-{name}": (text.encode(), importing("--untried")) for name, text in lab_replicas.TEXTS.items()}
    scipy.io.savemat(folder / "x.mat", lab_replicas.matlab_arrays())
    found["lab.mat"] = ((folder / "x.mat").read_bytes(), importing())
    data = Path(os.environ.get("KINEGRAPH_DATA", "/nonexistent"))
    real = [data / "files" / "c3d" / f"{name}.c3d" for name in ("pc_int", "dec_real", "gait_bmc", "sgi_int")]
    found |= {path.name: (path.read_bytes(), importing()) for path in real if path.is_file()}
    notes = [edfio.EdfAnnotation(30 * k, 30, f"Sleep stage {'WN'[k % 2]}{k % 2 or ''}") for k in range(20)]
    edfio.Edf([edfio.EdfSignal(np.arange(300.0), 100)], recording=RECORDED).write(folder / "y.edf")
    found["lab.edf"] = ((folder / "y.edf").read_bytes(), importing())
    edfio.Edf([edfio.EdfSignal(np.zeros(600), 1)], annotations=notes, recording=RECORDED).write(folder / "x.edf")
    found["hypnogram.edf"] = ((folder / "x.edf").read_bytes(), hypnogram)
    return found


EPOCHS = (
    "onset,end,state,provisional,rescored,score,activity,bed,moved_s,seen,crosstalk,breaths_per_min,confidence\n"
    + "".join(
        f"2024-05-01T22:{k:02d}:00Z,2024-05-01T22:{k:02d}:30Z,sleep,sleep,0,0.5,1,in,2,1,,14,0.9\n" for k in range(40)
    )
)


def importing_skeleton(path: Path) -> None:
    from kinegraph.devices.formats.asf.reader import read_amc, read_asf

    motion = path.with_name("motion.amc")
    motion.write_text(AMC)
    read_amc(motion, read_asf(path))


NAMES = (
    *("walk.bvh", "walk.amc", "walk.asf", "kinect.csv", "named.csv", "emg.csv", "x.npz", "y.npz", "x.xdf", "x.mcap"),
    *("hypnogram.csv", "truth.csv", "truth.npz", "checkpoint.bin", "epochs.csv", "hypnogram.edf"),
    *("pc_int.c3d", "dec_real.c3d", "gait_bmc.c3d", "sgi_int.c3d"),
    *(f"lab-{name}" for name in lab_replicas.TEXTS),
    *("lab.mat", "lab.edf"),
)


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory, made: Path) -> dict[str, tuple[bytes, Reader]]:
    return seeds(tmp_path_factory.mktemp("seeds"), made)


@pytest.mark.timeout(300 + 2 * SECONDS)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_told_by_name(valid: dict[str, tuple[bytes, Reader]], name: str, tmp_path: Path) -> None:
    if name not in valid:
        pytest.skip("KINEGRAPH_DATA (the folder of real recordings) is not set")
    whole, read = valid[name]
    path = tmp_path / name
    path.with_suffix(".asf").write_text(ASF)
    path.write_bytes(whole)
    read(path)
    seed, share = seed_of(name), 5 if name.startswith("lab") else 1
    chance, end, tried = random.Random(seed), time.monotonic() + SECONDS / share**2, 0
    most = MUTANTS // share
    while tried < most or time.monotonic() < end:
        data = mutant(whole, chance)
        path.write_bytes(data)
        begun = time.process_time()
        try:
            read(path)
        except KinegraphError as error:
            assert any(str(part) in str(error) for part in (path, path.parent)), (seed, tried, error)
        except Exception as error:
            (Path(os.environ.get("KINEGRAPH_FUZZ_KEEP", tmp_path)) / f"failed-{name}").write_bytes(data)
            raise AssertionError(f"mutant {tried} of {seed!r}: {type(error).__name__}: {error}") from error
        assert time.process_time() - begun < MOST_S, f"mutant {tried} of {seed!r} took too long"
        tried += 1
