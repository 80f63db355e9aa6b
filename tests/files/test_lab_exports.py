"""Exports, each opened by the library that its people use, against what the recording holds."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import ezc3d
import numpy as np
import openpyxl
import pandas
import pyarrow.parquet
import pyedflib
import pytest
import scipy.io

from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.devices.formats.importer import read_files
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.convert_run import kinegraph

START = 1_700_000_000 * NS + NS // 4
MARK = np.dtype([("onset", "<i8")])
NOTE = np.dtype([("onset", "<i8"), ("text", "<U16")])


@pytest.fixture
def walk(tmp_path: Path) -> dict[str, Series]:
    """A recording, walk.mcap: EMG with a gap, markers of which one is not seen for a while, contacts, words, a coarser signal."""
    random = np.random.default_rng(5)
    emg = random.normal(0, 60, (1990, 2))
    time = grid(1000.0, 2000, START)
    keep = np.r_[0:700, 710:2000]
    lost = np.zeros(1990, np.int64)
    lost[700] = 10
    markers = random.normal(800, 50, (200, 3, 3))
    markers[20:25, 1] = np.nan
    strikes = np.array([(START + k * NS // 2,) for k in range(4)], MARK)
    words = np.array([(START + NS // 3, "=1+1"), (START + NS, "halt")], NOTE)
    angle = np.sin(np.arange(100) / 9)[:, None] * 40
    spec = StreamSpec((2,), rate_hz=1000.0, channels=("TA", "GM"), units=("uV",))
    points = StreamSpec((3, 3), rate_hz=100.0, channels=("LTOE", "RTOE", "LHIP"), units=("mm",))
    contact = StreamSpec((), MARK, units=("ns",), meta={"label": "Foot Strike", "side": "right"})
    made = [
        Series("lab.emg", spec, time[keep], emg, lost),
        Series("lab.markers", points, grid(100.0, 200, START), markers),
        Series("lab.right_foot_strike", contact, strikes["onset"].copy(), strikes),
        Series("lab.words", StreamSpec((), NOTE, units=("ns", "")), words["onset"].copy(), words),
        Series(
            "lab.knee",
            StreamSpec((1,), rate_hz=50.0, channels=("knee_angle_r",), units=("deg",)),
            grid(50.0, 100, START),
            angle,
        ),
    ]
    header = {"graph": "", "session": {"subject": "S01", "age": 31, "task": "walk"}}
    write_recording(tmp_path / "walk.mcap", made, header)
    return {one.name.removeprefix("lab."): one for one in made}


def export(tmp_path: Path, name: str, *arguments: object) -> Path:
    kinegraph("files", "export", tmp_path / "walk.mcap", "-o", tmp_path / name, *arguments)
    return tmp_path / name


def again(path: Path) -> dict[str, Series]:
    """An export as it is imported again."""
    return {one.name.removeprefix(path.stem).removeprefix("."): one for one in read_files([path], ImportOptions())}


def test_excel(tmp_path: Path, walk: dict[str, Series]) -> None:
    book = openpyxl.load_workbook(export(tmp_path, "walk.xlsx"), read_only=True)
    assert book.sheetnames == ["lab.emg", "lab.markers", "lab.right_foot_strike", "lab.words", "lab.knee", "about"]
    rows = list(book["lab.emg"].iter_rows(values_only=True))
    assert rows[0] == ("time [s]", "TA [uV]", "GM [uV]") and len(rows) == 1991
    np.testing.assert_allclose(np.array(rows[1:], float)[:, 1:], walk["emg"].data, rtol=1e-12)
    markers = list(book["lab.markers"].iter_rows(values_only=True))
    assert markers[21][4] is None and markers[0][4] == "RTOE.x [mm]"
    assert "=1+1" not in [row[2] for row in book["lab.words"].iter_rows(values_only=True)], (
        "a text never becomes a formula"
    )
    assert ("subject", "S01") in list(book["about"].iter_rows(values_only=True))


def test_matlab(tmp_path: Path, walk: dict[str, Series]) -> None:
    found = scipy.io.loadmat(export(tmp_path, "walk.mat"), simplify_cells=True)
    emg = found["lab_emg"]
    assert (
        np.array_equal(emg["data"], walk["emg"].data)
        and emg["rate_hz"] == 1000
        and list(emg["channels"]) == ["TA", "GM"]
    )
    assert emg["time_s"][700] == pytest.approx(0.71) and list(emg["units"]) == ["uV", "uV"]
    assert found["lab_markers"]["data"].shape == (200, 3, 3) and found["lab_words"]["text"][1] == "halt"
    assert np.array_equal(found["lab_right_foot_strike"]["onset"], walk["right_foot_strike"].data["onset"])
    assert found["about"]["subject"] == "S01"


def test_parquet(tmp_path: Path, walk: dict[str, Series]) -> None:
    folder = export(tmp_path, "tables", "--format", "parquet")
    frame = pandas.read_parquet(folder / "lab.emg.parquet")
    assert list(frame.columns) == ["time", "TA", "GM"] and np.array_equal(
        frame[["TA", "GM"]].to_numpy(), walk["emg"].data
    )
    assert np.array_equal(frame["time"].astype("int64"), walk["emg"].time)
    about = json.loads(pyarrow.parquet.read_schema(folder / "lab.emg.parquet").metadata[b"kinegraph"])
    assert about["units"] == {"TA": "uV", "GM": "uV"} and about["session"]["subject"] == "S01"
    assert pandas.read_parquet(folder / "lab.words.parquet")["text"].tolist() == ["=1+1", "halt"]


def test_c3d(tmp_path: Path, walk: dict[str, Series]) -> None:
    chosen = [a for name in ("emg", "markers", "right_foot_strike") for a in ("--stream", f"lab.{name}")]
    path = export(tmp_path, "walk.c3d", *chosen)
    found = ezc3d.c3d(str(path))
    points = found["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(points, walk["markers"].data, rtol=1e-6)
    assert np.isnan(points[20:25, 1]).all() and found["parameters"]["POINT"]["RATE"]["value"][0] == 100
    analog = found["data"]["analogs"][0].T
    assert found["parameters"]["ANALOG"]["RATE"]["value"][0] == 1000 and not analog[700:710].any()
    np.testing.assert_allclose(np.delete(analog, np.s_[700:710], 0), walk["emg"].data, rtol=1e-6)
    assert list(found["parameters"]["ANALOG"]["UNITS"]["value"]) == ["uV", "uV"]
    assert list(found["parameters"]["EVENT"]["CONTEXTS"]["value"]) == ["Right"] * 4
    np.testing.assert_allclose(found["parameters"]["EVENT"]["TIMES"]["value"][1], [0.0, 0.5, 1.0, 1.5], atol=1e-6)
    back = again(path)
    assert (back["right_foot_strike"].data["onset"] / NS).tolist() == pytest.approx([0.0, 0.5, 1.0, 1.5])
    with pytest.raises(
        RecordingError, match=r"one rate for signals, a multiple of the frames' 100 Hz; choose with --stream"
    ):
        export(tmp_path, "all.c3d")


@pytest.mark.parametrize("away_s", [-60, 60])
def test_what_is_measured_at_another_time_than_the_markers_is_no_fault_of_a_c3d_file(
    tmp_path: Path, walk: dict[str, Series], away_s: int, capsys: pytest.CaptureFixture[str]
) -> None:
    angles, emg = (
        StreamSpec((1,), rate_hz=hz, channels=(name,), units=(unit,))
        for hz, name, unit in ((100.0, "LKnee.flexion", "deg"), (1000.0, "TA", "uV"))
    )
    away = START + away_s * NS
    made = [
        walk["markers"],
        Series("walk.angles", angles, grid(100.0, 200, away), np.full((200, 1), 20.0)),
        Series("walk.emg", emg, grid(1000.0, 2000, away), np.full((2000, 1), 20.0)),
    ]
    write_recording(tmp_path / "apart.mcap", made, {"graph": "", "session": {}})
    kinegraph("files", "export", tmp_path / "apart.mcap", "-o", tmp_path / "apart.c3d")
    found = ezc3d.c3d(str(tmp_path / "apart.c3d"))["data"]
    assert np.isnan(found["points"][0, 3]).all() and not found["analogs"].any()
    assert capsys.readouterr().out.count("no sample is within the time of the file's frames") == 2


def test_joint_angles_are_in_a_c3d_file_as_laboratories_have_them(tmp_path: Path, walk: dict[str, Series]) -> None:
    """One point of three degrees per joint beside the markers, and the feet's events with their leg; rows per channel are no events."""
    names = ("Pelvis.tilt", "LKnee.flexion", "LKnee.adduction", "LKnee.rotation", "LAnkle.flexion", "LAnkle.rotation")
    data = np.random.default_rng(6).normal(0, 20, (200, 6))
    data[10] = np.nan
    spec = StreamSpec((6,), rate_hz=100.0, channels=names, units=("deg",))
    both = np.array([(START + NS, "left"), (START + 3 * NS // 2, "right")], [("onset", "<i8"), ("limb", "<U16")])
    rows = np.zeros(3, [("onset", "<i8"), ("number", "<i8"), ("name", "<U16")])
    rows["onset"], rows["name"] = START + NS, ["LKnee.flexion", "RKnee.flexion", "Pelvis.tilt"]
    made = [
        walk["markers"],
        Series("walk.angles", spec, grid(100.0, 200, START), data),
        Series("feet.touchdown", StreamSpec((), both.dtype, units=("ns", "")), both["onset"].copy(), both),
        Series("walk.statistics", StreamSpec((), rows.dtype, units=("ns", "", "")), rows["onset"].copy(), rows),
    ]
    write_recording(tmp_path / "angles.mcap", made, {"graph": "", "session": {}})
    kinegraph("files", "export", tmp_path / "angles.mcap", "-o", tmp_path / "angles.c3d")
    found = ezc3d.c3d(str(tmp_path / "angles.c3d"))
    labels = found["parameters"]["POINT"]["LABELS"]["value"]
    assert (
        labels[3:] == ["PelvisAngles", "LKneeAngles", "LAnkleAngles"] == found["parameters"]["POINT"]["ANGLES"]["value"]
    )
    points = found["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_allclose(points[:, 4], data[:, 1:4], rtol=1e-5)
    np.testing.assert_allclose(np.delete(points, 10, 0)[:, 5, [0, 2]], np.delete(data, 10, 0)[:, 4:], rtol=1e-5)
    assert found["parameters"]["ANALOG"]["USED"]["value"][0] == 0
    events = found["parameters"]["EVENT"]
    times = events["TIMES"]["value"][1].round(3).tolist()
    assert list(zip(events["CONTEXTS"]["value"], events["LABELS"]["value"], times, strict=True)) == [
        ("Left", "Foot Strike", 1.0), ("Right", "Foot Strike", 1.5),
    ]  # fmt: skip


def test_opensim(tmp_path: Path, walk: dict[str, Series]) -> None:
    back = again(export(tmp_path, "walk.trc"))["markers"]
    np.testing.assert_allclose(back.data, walk["markers"].data, rtol=1e-9)
    assert back.spec.rate_hz == 100 and back.spec.channels == ("LTOE", "RTOE", "LHIP") and back.spec.units == ("mm",)
    lines = (tmp_path / "walk.trc").read_text().splitlines()
    assert {len(line.split("\t")) for line in (lines[3], lines[4], lines[6])} == {11} and lines[2].split("\t")[2:4] == [
        "200",
        "3",
    ]
    back = again(export(tmp_path, "knee.mot", "--stream", "lab.knee"))["coordinates"]
    np.testing.assert_allclose(back.data, walk["knee"].data, rtol=1e-9)
    assert back.spec.units == ("deg",) and back.spec.rate_hz == 50
    frame = pandas.read_csv(tmp_path / "knee.mot", sep="\t", skiprows=7)
    assert list(frame.columns) == ["time", "knee_angle_r"] and len(frame) == 100
    with pytest.raises(RecordingError, match=r"holds one stream of numbers; name it with --stream .lab.emg, lab.knee."):
        export(tmp_path, "walk.sto")


@pytest.mark.parametrize("suffix", ["edf", "bdf"])
def test_edf(tmp_path: Path, walk: dict[str, Series], suffix: str) -> None:
    path = export(tmp_path, f"walk.{suffix}")
    found = pyedflib.EdfReader(str(path))
    try:
        assert found.getSignalLabels() == ["TA", "GM", "knee_angle_r"] and list(found.getSampleFrequencies()) == [
            1000,
            1000,
            50,
        ]
        step = found.getPhysicalMaximum(0) / (2**23 if suffix == "bdf" else 2**15)
        data = found.readSignal(0)
        np.testing.assert_allclose(np.delete(data, np.s_[700:710]), walk["emg"].data[:, 0], atol=2 * step)
        assert found.getPhysicalDimension(0) == "uV" and found.getPatientCode() == "S01"
        onsets, lengths, texts = found.readAnnotations()
        missing = texts.tolist().index("missing TA")
        assert onsets[missing] == pytest.approx(0.7) and float(lengths[missing]) == pytest.approx(0.01)
        assert [t for t in texts if "Foot" in t] == ["right Foot Strike"] * 4 and "halt" in texts
    finally:
        found.close()
    back = again(path)
    assert back["signals_1000hz"].time[0] == START and back["signals_50hz"].spec.units == ("deg",)


def test_bids(tmp_path: Path, walk: dict[str, Series]) -> None:
    folder = export(tmp_path, "study", "--format", "bids")
    motion = folder / "sub-S01" / "motion" / "sub-S01_task-walk_tracksys-kinegraph_motion.tsv"
    table = pandas.read_csv(motion, sep="\t", header=None, na_values="n/a")
    channels = pandas.read_csv(motion.with_name("sub-S01_task-walk_tracksys-kinegraph_channels.tsv"), sep="\t")
    assert table.shape == (200, 9) and list(channels["component"]) == ["x", "y", "z"] * 3
    about = json.loads(motion.with_suffix(".json").read_text())
    assert about["SamplingFrequency"] == 100 and about["MotionChannelCount"] == len(channels) == 9
    assert json.loads((folder / "dataset_description.json").read_text())["BIDSVersion"]
    people = pandas.read_csv(folder / "participants.tsv", sep="\t")
    assert people["participant_id"].tolist() == ["sub-S01"] and people["age"].tolist() == [31]
    emg = folder / "sub-S01" / "emg" / "sub-S01_task-walk_emg.edf"
    with pyedflib.EdfReader(str(emg)) as found:
        assert found.getSignalLabels() == ["TA", "GM"]
    names = pandas.read_csv(emg.with_name("sub-S01_task-walk_channels.tsv"), sep="\t")
    assert names["type"].tolist() == ["EMG", "EMG"] and names["units"].tolist() == ["uV", "uV"]
    events = pandas.read_csv(emg.with_name("sub-S01_task-walk_events.tsv"), sep="\t")
    assert events["onset"].tolist()[0] == 0 and "right Foot Strike" in events["trial_type"].tolist()
    options = ImportOptions()
    back = {one.name.rpartition(".")[2]: one for one in read_files([motion], options)}
    np.testing.assert_allclose(back["markers"].data, walk["markers"].data, rtol=1e-9)
    assert options.findings.facts["subject"] == "S01"


VALIDATOR = Path(sys.executable).parent / "bids-validator-deno"


def complaints(study: Path) -> list[tuple[str, str]]:
    """Errors of the standard's own validator: code and file."""
    done = subprocess.run([VALIDATOR, "--format", "json", study], capture_output=True, text=True, timeout=200)
    found = json.loads(done.stdout)["issues"]["issues"]
    return [(one["code"], one.get("location", "")) for one in found if one["severity"] == "error"]


@pytest.mark.skipif(not VALIDATOR.exists(), reason="bids-validator-deno is not installed (extra `test`)")
def test_a_study_is_valid_to_the_bids_validator(tmp_path: Path, walk: dict[str, Series]) -> None:
    """A study of two people, one of whom did two tasks; a file of it that is changed by hand is no longer valid."""
    for subject, task in (("S01", "walk"), ("S02", "walk"), ("S02", "turn run")):
        session = {"subject": subject, "age": 31, "sex": "F", "handedness": "R", "task": task}
        write_recording(tmp_path / "walk.mcap", [*walk.values()], {"graph": "", "session": session}, overwrite=True)
        folder = export(tmp_path, "study", "--format", "bids")
    assert complaints(folder) == []
    assert {path.name for path in (folder / "sub-S02" / "emg").glob("*.edf")} == {
        "sub-S02_task-walk_emg.edf",
        "sub-S02_task-turnrun_emg.edf",
    }
    channels = folder / "sub-S01" / "emg" / "sub-S01_task-walk_channels.tsv"
    channels.write_text(channels.read_text().replace("EMG", "muscle"))
    assert [(code, Path(place).name) for code, place in complaints(folder)] == [
        ("TSV_VALUE_INCORRECT_TYPE", channels.name)
    ]


@pytest.mark.parametrize("suffix", ["edf", "bdf"])
def test_mne_reads_what_is_exported(tmp_path: Path, walk: dict[str, Series], suffix: str) -> None:
    mne = pytest.importorskip("mne", reason="mne is not installed (extra `test`)")
    path = export(
        tmp_path, f"walk.{suffix}", "--stream", "lab.emg", "--stream", "lab.words", "--stream", "lab.right_foot_strike"
    )
    raw = (mne.io.read_raw_bdf if suffix == "bdf" else mne.io.read_raw_edf)(path, verbose="error")
    assert raw.ch_names == ["TA", "GM"] and raw.info["sfreq"] == 1000 and raw.info["subject_info"]["his_id"] == "S01"
    values = np.delete(raw.get_data(units="uV").T, np.s_[700:710], 0)
    np.testing.assert_allclose(values, walk["emg"].data, atol=2e-5 if suffix == "bdf" else 0.01)
    texts = raw.annotations.description.tolist()
    assert texts.count("right Foot Strike") == 4 and "halt" in texts
    (gap,) = (one for one in raw.annotations if one["description"] == "missing TA")
    assert gap["onset"] == pytest.approx(0.7) and gap["duration"] == pytest.approx(0.01)


def test_opensim_itself_reads_what_is_exported(tmp_path: Path, walk: dict[str, Series]) -> None:
    opensim = pytest.importorskip("opensim", reason="OpenSim is not installed (extra `peers`)")
    markers = opensim.TimeSeriesTableVec3(str(export(tmp_path, "walk.trc")))
    assert list(markers.getColumnLabels()) == ["LTOE", "RTOE", "LHIP"]
    assert markers.getTableMetaDataString("DataRate") == "100" and markers.getTableMetaDataString("Units") == "mm"
    read = np.array(
        [
            [cell.to_numpy() for cell in map(row.getElt, [0] * 3, range(3))]
            for row in map(markers.getRowAtIndex, range(200))
        ]
    )
    np.testing.assert_allclose(read, walk["markers"].data, rtol=1e-9)
    for suffix in ("mot", "sto"):
        angle = opensim.TimeSeriesTable(str(export(tmp_path, f"knee.{suffix}", "--stream", "lab.knee")))
        assert list(angle.getColumnLabels()) == ["knee_angle_r"] and angle.getTableMetaDataString("inDegrees") == "yes"
        np.testing.assert_allclose(angle.getMatrix().to_numpy(), walk["knee"].data, rtol=1e-9)
        np.testing.assert_allclose(np.diff(angle.getIndependentColumn()), 0.02, atol=1e-9)


def test_nothing_is_replaced_unasked(tmp_path: Path, walk: dict[str, Series]) -> None:
    for name in ("walk.xlsx", "walk.mat", "walk.trc", "walk.edf"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(RecordingError, match="already exists"):
            export(tmp_path, name)
        assert (tmp_path / name).read_text() == "mine"
