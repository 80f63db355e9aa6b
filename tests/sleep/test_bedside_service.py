"""The systemd unit: systemd accepts it, and its command goes on with what a power cut has broken off."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from configparser import ConfigParser
from pathlib import Path

import pytest

UNIT = Path(__file__).resolve().parents[2] / "configs" / "kinegraph-bedside.service"
FAKE = """#!/bin/sh
echo "$@" >> calls
case "$*" in *--resume*) exit $(cat resumes);; esac
mkdir -p session
"""


def command() -> str:
    """What the unit runs, as systemd hands it to the shell."""
    unit = ConfigParser(interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text().replace("\\\n", " "))
    line = unit["Service"]["ExecStart"]
    assert line.startswith("/bin/sh -c '") and line.endswith("'")
    return line.removeprefix("/bin/sh -c '").removesuffix("'").replace("$$", "$")


def started(folder: Path, *, checkpoint: bool, resumes: int = 0) -> tuple[int, list[str]]:
    """The exit code, and how kinegraph was called."""
    program = folder / "bin" / "kinegraph"
    program.parent.mkdir(parents=True)
    program.write_text(FAKE)
    program.chmod(0o755)
    (folder / "resumes").write_text(str(resumes))
    (folder / "session").mkdir()
    (folder / "session" / "session.0000.mcap").touch()
    if checkpoint:
        (folder / "session" / "checkpoint.npz").touch()
    path = f"{program.parent}:{os.environ['PATH']}"
    done = subprocess.run(["/bin/sh", "-c", command()], cwd=folder, env={**os.environ, "PATH": path}, timeout=60)
    return done.returncode, (folder / "calls").read_text().splitlines()


NEW = "run bedside.yaml -o session --view lines"
RESUMED = "run bedside.yaml -o session --resume --view lines"


def test_a_broken_off_night_goes_on(tmp_path: Path) -> None:
    assert started(tmp_path, checkpoint=True) == (0, [RESUMED])


def test_one_without_a_checkpoint_goes_on_from_its_beginning(tmp_path: Path) -> None:
    assert started(tmp_path, checkpoint=False) == (0, [RESUMED])
    assert (tmp_path / "session" / "session.0000.mcap").exists()


def test_one_that_cannot_go_on_is_put_aside_and_nothing_is_deleted(tmp_path: Path) -> None:
    (tmp_path / "session.1").mkdir()
    assert started(tmp_path, checkpoint=True, resumes=2) == (0, [RESUMED, NEW])
    assert (tmp_path / "session.2" / "session.0000.mcap").exists() and (tmp_path / "session.1").exists()


@pytest.mark.parametrize(("rolling", "kept"), [("true", False), ("false", True)])
def test_what_was_put_aside_is_deleted_after_a_month_unless_it_is_a_whole_recording(
    tmp_path: Path, rolling: str, kept: bool
) -> None:
    (tmp_path / "bedside.yaml").write_text(f"recording: {{folder: recordings, rolling: {rolling}}}")
    for name, age_days in (("session.1", 40), ("session.2", 3)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "session.0000.mcap").touch()
        then = time.time() - 86_400 * age_days
        os.utime(tmp_path / name, (then, then))
    started(tmp_path, checkpoint=True, resumes=2)
    assert (tmp_path / "session.1").exists() is kept
    assert (tmp_path / "session.2").exists() and (tmp_path / "session").exists()


def test_a_camera_that_is_missing_is_tried_again_by_systemd(tmp_path: Path) -> None:
    assert started(tmp_path, checkpoint=True, resumes=3) == (3, [RESUMED])
    assert (tmp_path / "session" / "checkpoint.npz").exists()


def test_a_stop_that_reaches_the_shell_waits_until_the_night_has_ended_in_order(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "kinegraph"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\ntouch going\nsleep 1\ntouch ended\nexit 0\n")
    program.chmod(0o755)
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "session.0000.mcap").touch()
    path = f"{program.parent}:{os.environ['PATH']}"
    shell = subprocess.Popen(["/bin/sh", "-c", command()], cwd=tmp_path, env={**os.environ, "PATH": path})
    while not (tmp_path / "going").exists():
        assert shell.poll() is None
        time.sleep(0.01)
    shell.terminate()
    assert shell.wait(60) == 0 and (tmp_path / "ended").exists()


def test_compiled_kernels_have_a_place_though_the_user_has_no_home() -> None:
    lines = UNIT.read_text().splitlines()
    (folder,) = (line.partition("=")[2] for line in lines if line.startswith("CacheDirectory="))
    (named,) = (word for line in lines for word in line.split() if word.startswith("Environment=KINEGRAPH_CACHE="))
    assert named == f"Environment=KINEGRAPH_CACHE=/var/cache/{folder}"


def test_systemd_accepts_the_unit() -> None:
    if not shutil.which("systemd-analyze"):
        pytest.skip("no systemd here")
    done = subprocess.run(["systemd-analyze", "verify", str(UNIT)], capture_output=True, text=True, timeout=60)
    mine = [line for line in done.stderr.splitlines() if UNIT.name in line]
    assert not mine, mine


def test_the_unit_is_shut_in() -> None:
    if not shutil.which("systemd-analyze"):
        pytest.skip("no systemd here")
    call = ["systemd-analyze", "security", "--offline=true", "--threshold=30", str(UNIT)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout.splitlines()[-1:] or done.stderr
    assert "UMask=0077" in UNIT.read_text() and "StateDirectoryMode=0700" in UNIT.read_text()
