"""A disk that is slow, full, or refuses: the session never waits, what was written stays readable, what was not is counted."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.write.quota import keep_quota
from kinegraph.stream.recording.write.record_writer import RecordWriter
from tests.recordings.test_recording import START, assert_recorded, record, same, session
from tests.support.disks import Disk

COUNTED = StreamSpec((8,), rate_hz=1000.0)
"""A stream whose first channel is the sample's number."""


def counted(start: int, n: int) -> Chunk:
    data = np.random.default_rng(start).normal(size=(n, 8))
    data[:, 0] = np.arange(start, start + n)
    times = START + np.arange(start, start + n) * 1_000_000
    return Chunk(times, data, int(times[-1]))


def feed(recorder: Recorder, start: int, chunks: int, n: int = 50, pause: float = 0.0) -> int:
    """Write `chunks` chunks of `n` samples from sample `start` on; returns the next sample's number."""
    for i in range(chunks):
        chunk = counted(start + i * n, n)
        recorder.write(2, chunk, chunk.until, start + i * n)
        time.sleep(pause)
    return start + chunks * n


def until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.01)


def counted_recorder(path: Path, **more: Any) -> Recorder:
    recorder = Recorder(path, {}, RecordingOptions(flush_s=0.02, gather_s=0.01), **more)
    assert recorder.add_stream("board", COUNTED, "input") == 2
    return recorder


def assert_holes_are_told(recording: Recording, dropped_chunks: int, n: int = 50) -> None:
    """Every sample that is there is right and in order; every hole stands in the `lost` of the chunk after it."""
    expected = 0
    for chunk in recording.chunks("board"):
        assert chunk.data[0, 0] == expected + chunk.lost
        expected = int(chunk.data[-1, 0]) + 1
        assert np.array_equal(chunk.data, counted(int(chunk.data[0, 0]), len(chunk)).data)
    stream = recording.streams["board"]
    assert stream.dropped == dropped_chunks * n
    assert stream.samples + stream.dropped == stream.end == recording.last_samples("board")


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk().put_in(monkeypatch)


def test_what_is_behind_counts_from_the_first_chunk(tmp_path: Path) -> None:
    with Recorder(tmp_path / "s", {}, RecordingOptions(flush_s=60.0)) as recorder:
        recorder.add_stream("board", COUNTED, "input")
        feed(recorder, 0, 3, n=500)
        assert recorder.status.behind_s == 1.0  # nothing is on the disk yet


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
def test_a_full_disk_costs_nothing_while_memory_lasts(tmp_path: Path, disk: Disk, error: int) -> None:
    disk.room, disk.error = 20_000, error
    recorder = counted_recorder(tmp_path / "s")
    at = feed(recorder, 0, 40)
    until(lambda: recorder.status.error != "")
    at = feed(recorder, at, 40)
    held = recorder.status
    assert held.dropped == {} and held.behind_s > 0
    if error == errno.ENOSPC:
        with Recording.open(tmp_path / "s") as unfinished:
            assert not unfinished.finished
    disk.room = float("inf")
    until(lambda: recorder.status.error == "")
    feed(recorder, at, 10)
    recorder.close()
    with Recording.open(tmp_path / "s") as recording:
        assert_holes_are_told(recording, 0)
        assert recording.last_samples("board") == 90 * 50
        assert [line["kind"] for line in recording.log] == ["disk refused"]
        assert recording.log[0]["error"] == os.strerror(error)


def test_a_full_disk_and_full_memory_drop_and_count(tmp_path: Path, disk: Disk) -> None:
    disk.room = 20_000
    recorder = counted_recorder(tmp_path / "s", queue_bytes=200_000)
    at = feed(recorder, 0, 20)
    until(lambda: recorder.status.error != "")
    at = feed(recorder, at, 500)  # which never ends if it waits for the disk
    dropped = recorder.status.dropped["board"]
    assert dropped > 300
    disk.room = float("inf")
    until(lambda: recorder.status.error == "" and recorder.status.behind_s < 0.05)
    at = feed(recorder, at, 10)
    time.sleep(0.1)
    feed(recorder, at, 10)
    recorder.close()
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished
        assert_holes_are_told(recording, dropped)
        assert recording.last_samples("board") == 540 * 50
        lines = [line["chunks"]["board"] for line in recording.log if line["kind"] == "recorder dropped"]
        assert sum(lines) == dropped


def test_closing_on_a_disk_that_stays_full_ends_and_leaves_a_readable_file(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.stream.recording.write.record_writer.GRACE_S", 0.3)
    disk.room = 20_000
    recorder = counted_recorder(tmp_path / "s")
    feed(recorder, 0, 20, pause=0.01)
    until(lambda: recorder.status.error != "")
    feed(recorder, 1000, 5)
    recorder.close()
    assert recorder.status.error == os.strerror(errno.ENOSPC)
    with pytest.raises(RecordingError, match=os.strerror(errno.ENOSPC)):
        recorder.check()
    with Recording.open(tmp_path / "s") as recording:
        assert not recording.finished
        assert_holes_are_told(recording, 0)
        assert 0 < recording.last_samples("board") < 1250


class RefusingSegments:
    """Files that refuse to be written so many times."""

    def __init__(self, times: int) -> None:
        self.left, self.lines = times, list[bytes]()

    def save(self, *, sync: bool) -> None:
        self.left -= 1
        if self.left >= 0:
            raise OSError(errno.ENOSPC, "No space left on device")

    def add(self, topic: int, arrival: int, stamp: int, batch: int, body: bytes) -> None:
        self.lines.append(body)


def test_one_that_must_stop_tries_again_before_it_gives_up(tmp_path: Path) -> None:
    stop, segments = Event(), RefusingSegments(3)
    writer = RecordWriter(tmp_path, [], segments, stop, live=True)  # type: ignore[arg-type]
    assert writer.done == 0
    stop.set()
    writer.save()
    assert writer.error == "" and len(segments.lines) == 1 and b"disk refused" in segments.lines[0]


def test_a_slow_disk_drops_and_counts(tmp_path: Path, disk: Disk) -> None:
    disk.delay_s = 0.3
    recorder = counted_recorder(tmp_path / "s", queue_bytes=100_000)
    at = feed(recorder, 0, 300, pause=0.002)
    assert recorder.status.dropped["board"] > 50
    disk.delay_s = 0.0
    until(lambda: recorder.status.behind_s < 0.05)
    feed(recorder, at, 10)
    recorder.close()
    with pytest.raises(RecordingError, match="the disk was too slow"):
        recorder.check()
    with Recording.open(tmp_path / "s") as recording:
        assert_holes_are_told(recording, recorder.status.dropped["board"])


def test_waiting_writers_lose_nothing_on_a_slow_disk(tmp_path: Path, disk: Disk) -> None:
    disk.delay_s = 0.02
    recorder = counted_recorder(tmp_path / "s", queue_bytes=100_000, wait=True)
    feed(recorder, 0, 300)
    recorder.close()
    with Recording.open(tmp_path / "s") as recording:
        assert_holes_are_told(recording, 0)
        assert recording.last_samples("board") == 15_000


def test_a_session_without_live_sources_waits_for_a_slow_disk(tmp_path: Path, disk: Disk) -> None:
    disk.delay_s = 0.02
    recorder = counted_recorder(tmp_path / "s", queue_bytes=100_000, waits=True)
    feed(recorder, 0, 300)
    assert recorder.status.dropped == {}
    recorder.close()
    with Recording.open(tmp_path / "s") as recording:
        assert_holes_are_told(recording, 0)
        assert recording.last_samples("board") == 15_000


def test_only_a_session_without_live_sources_has_a_recorder_that_waits(tmp_path: Path) -> None:
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.graph.reading.load import load_text

    for realtime in (False, True):
        text = f"nodes:\n  board: {{use: devices.people.treadmill.Treadmill, realtime: {str(realtime).lower()}, duration_s: 1}}\n"
        session = Session(load_text(text), tmp_path / str(realtime))
        session.log.open()
        recorder = session.log.recorder
        assert recorder is not None and recorder.waits is not realtime
        recorder.close()


LIMITED = """
import resource, sys, time
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from tests.recordings.test_recording_disk import counted_recorder, feed
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
recorder = counted_recorder(Path(sys.argv[2]))
feed(recorder, 0, 400, pause=0.003)
recorder.close()
print(recorder.status.dropped)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no RLIMIT_FSIZE")
def test_files_that_may_not_grow_any_more_are_followed_by_further_parts(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LIMITED, str(Path(__file__).resolve().parents[2]), str(tmp_path / "s")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.endswith("\n{}\n")
    sizes = [p.stat().st_size for p in (tmp_path / "s").glob("*.mcap")]
    assert len(sizes) > 3 and max(sizes) <= 300_000
    with Recording.open(tmp_path / "s") as recording:
        assert_holes_are_told(recording, 0)
        assert recording.last_samples("board") == 20_000


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 300 KB, where we may mount one."""
    place = tmp_path / "small"
    place.mkdir()
    try:
        mounted = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(place)], capture_output=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("no mount command on this system")
    if mounted.returncode:
        pytest.skip("mounting a small file system needs root")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_file_system_that_really_is_full(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(200_000))
    recorder = counted_recorder(small_disk / "s")
    at = feed(recorder, 0, 60)
    until(lambda: recorder.status.error != "")
    ballast.unlink()
    until(lambda: recorder.status.error == "")
    feed(recorder, at, 10)
    recorder.close()
    with Recording.open(small_disk / "s") as recording:
        assert recording.finished
        assert_holes_are_told(recording, 0)
        assert recording.last_samples("board") == 3500
    (small_disk / "ballast").write_bytes(bytes(10_000))
    with (small_disk / "rest").open("wb", buffering=0) as rest, pytest.raises(OSError, match="No space"):
        while rest.write(bytes(4096)):
            pass
    with pytest.raises(RecordingError, match=r"No space left on device.*free some space"):
        Recorder(small_disk / "t", {}, RecordingOptions())


def test_the_quota_takes_the_oldest_closed_recordings_and_nothing_else(tmp_path: Path) -> None:
    made = session()
    for i, name in enumerate(["a", "b.mcap", "c", "running", "d"]):
        record(tmp_path / name, made).close()
        for part in tmp_path.glob(f"{name}/*.mcap") if "." not in name else [tmp_path / name]:
            os.utime(part, (1000 + i, 1000 + i))
    (tmp_path / "a" / "report.html").write_text("kept")
    (tmp_path / "foreign.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100_000))
    os.utime(tmp_path / "foreign.mcap", (1, 1))
    os.utime(next((tmp_path / "running").glob("*.mcap")), (2, 2))
    size = (tmp_path / "b.mcap").stat().st_size / 1e6
    with Recorder(tmp_path / "running", {}, RecordingOptions(), resume=True):
        deleted = keep_quota(tmp_path / "d", 3.5 * size)
    assert deleted == [tmp_path / "a", tmp_path / "b.mcap"]
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file() and not p.name.startswith(".")}
    assert {
        "a/report.html",
        "foreign.mcap",
        "c/session.0000.mcap",
        "d/session.0000.mcap",
        "running/session.0000.mcap",
    } <= left
    assert "b.mcap" not in left and "a/session.0000.mcap" not in left
    assert_recorded(tmp_path / "c", made)


def test_a_recorder_keeps_the_quota_by_itself(tmp_path: Path) -> None:
    made = session()
    record(tmp_path / "old", made).close()
    record(tmp_path / "new", made, quota_mb=1e-6).close()
    assert not (tmp_path / "old").exists()
    assert_recorded(tmp_path / "new", made)


def test_grid_and_counted_agree() -> None:
    assert np.array_equal(counted(0, 5).time, grid(1000.0, 5, START))
    assert same(counted(3, 2), counted(3, 2))
