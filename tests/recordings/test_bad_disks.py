"""Disks that are full, folders that may not be written, files that are deleted meanwhile."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder, Recording
from tests.support.command_line import GRAPH, QUIET, Command, refused
from tests.support.disks import Disk


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The recorder's disk takes 20 KB."""
    Disk(20_000).put_in(monkeypatch)
    for module in ("recorder", "record_writer"):
        monkeypatch.setattr(f"kinegraph.stream.recording.write.{module}.GRACE_S", 0.2)
    yield


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("command", ["import", "replay"])
def test_a_disk_that_fills_up_while_files_are_made(
    command: str, kinegraph: Command, made: Path, tmp_path: Path
) -> None:
    if command == "import":
        np.savez(tmp_path / "t.npz", a=np.random.default_rng(1).normal(size=(50_000, 2)))
        output = kinegraph("files", "import", "t.npz", "-o", "t.mcap", "--stream", "x=a", "--rate", "1000")
        assert not (tmp_path / "t.mcap").exists()
    else:
        output = kinegraph("replay", made / "graph.yaml", made / "s", "-o", "again", "-q")
    refused(output, "not everything could be written (No space left on device)", "free some space")
    assert "the session goes on" not in output[2]


@pytest.mark.usefixtures("full_disk")
def test_a_disk_that_fills_up_during_a_session(kinegraph: Command, made: Path) -> None:
    output = kinegraph("run", made / "graph.yaml", *QUIET, "-o", "s")
    refused(output, "the recording cannot be written; the session goes on", "No space left on device", code=5)
    assert re.search(r"recording: the last \d\.\d s could not be written and are lost", output[2]), (
        "and not all since 1970"
    )


def delete(folder: Path) -> None:
    folder.rename(folder.with_name("gone"))  # at once: nothing new may appear in it meanwhile
    shutil.rmtree(folder.with_name("gone"))


def rename(folder: Path) -> None:
    folder.rename(folder.with_name("renamed"))


def cut(folder: Path) -> None:
    os.truncate(folder / "session.0000.mcap", 30)


@pytest.mark.parametrize(
    ("disturb", "complaint", "kept"),
    [
        (delete, "the file was deleted or moved", "missing: 10 samples before its first file"),
        (rename, "the file was deleted or moved", "missing: 10 samples before its first file"),
        (cut, "another program has cut the file", "missing: 10 samples before its first file"),
    ],
)
def test_a_recording_that_is_disturbed_while_it_is_written_goes_on_and_counts_what_is_missing(
    disturb: Callable[[Path], None], complaint: str, kept: str, tmp_path: Path, kinegraph: Command
) -> None:
    spec, folder = StreamSpec((1,), rate_hz=100.0), tmp_path / "s"
    with Recorder(folder, {"graph": GRAPH}, RecordingOptions(gather_s=0.01, flush_s=0.01)) as recorder:
        number = recorder.add_stream("board.emg", spec, "input")

        def write(k: int) -> None:
            recorder.write(number, Chunk(np.array([k * NS]), np.array([[float(k)]]), k * NS), k * NS, k)
            assert recorder.flush(60.0)

        for k in range(10):
            write(k)
        disturb(folder)
        for k in range(10, 20):
            write(k)
    assert recorder.status.shortfall == kept
    with Recording.open(folder) as recording:
        assert recording.read("board.emg")[1].ravel().tolist() == [float(k) for k in range(10, 20)]
        assert not recording.finished and recording.missing and recording.missing.words in kept
        assert any(e["kind"] == "disk refused" and complaint in e["error"] for e in recording.log)
        stream = recording.streams["board.emg"]
        assert (stream.samples, stream.gaps, stream.dropped) == (10, 1, 10)
    assert "10 samples before its first file" in kinegraph("info", folder)[1]


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder in which nobody may write, where we may mount one; it holds a file of ours."""
    place = tmp_path / "ro"
    place.mkdir()
    (place / "cal.json").write_text("{}")
    try:
        subprocess.run(["mount", "--bind", place, place], check=True, capture_output=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", place, place], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("mounting a read-only folder needs root")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_folders_that_may_not_be_written(kinegraph: Command, made: Path, read_only: Path, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a\n0,1\n1,2\n2,3\n")
    graph, whole = made / "graph.yaml", made / "s"
    refused(kinegraph("run", graph, *QUIET, "-o", "ro/s"), "ro/s: cannot be created (Read-only file system)")
    refused(kinegraph("files", "import", "t.csv", "-o", "ro/t.mcap"), "ro/t.mcap: cannot write there")
    refused(kinegraph("files", "export", whole, "-o", "ro/out"), "ro/out: cannot be written (Read-only file system)")
    refused(kinegraph("recover", whole, "-o", "ro/t.mcap"), "cannot be written (Read-only file system)")
    refused(kinegraph("dev", "schema", "-o", "ro/s.json"), "ro/s.json cannot be written: Read-only file system")
    assert [p.name for p in read_only.iterdir()] == ["cal.json"]
