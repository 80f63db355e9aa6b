"""Recordings: what is written is what is read, whatever happens to the process and to the disk."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec, empty
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder, Recording

pytestmark = pytest.mark.quick

EMG = StreamSpec((3,), np.dtype(np.float32), 1000.0, ("TA", "GM", "SOL"), ("uV",), meta={"site": "right leg"})
STEP = StreamSpec((), np.dtype([("onset", "<i8"), ("name", "<U8")]), units=("ns", ""))
MARKERS = StreamSpec((4, 3), rate_hz=100.0, units=("m",))
START = 1_700_000_000_000_000_000


def session(seed: int = 1, seconds: float = 2.0) -> list[tuple[str, Chunk, int]]:
    """(stream, chunk, arrival) of a made-up session in the order of arrival: gaps, empty chunks, events, an end."""
    rng = np.random.default_rng(seed)
    n = int(1000 * seconds)
    times = grid(1000.0, n, START)
    data = rng.normal(size=(n, 3)).astype(np.float32)
    data[:, 0] = np.arange(n)
    made: list[tuple[str, Chunk, int]] = []
    at = 0
    while at < n:
        m = int(rng.integers(0, 30))
        until = int(times[min(at + m, n) - 1]) if at + m else START - 1
        lost = int(rng.choice([0, 0, 0, 0, 7, -1])) if m else 0
        made.append(("board.emg", Chunk(times[at : at + m], data[at : at + m], until, lost), until + 2_000_000))
        if rng.random() < 0.2:
            step = np.array([(until, "touch")], STEP.dtype)
            made.append(("board.steps", Chunk(np.array([until]), step, until), until + 2_000_000))
        if rng.random() < 0.3:
            made.append(
                ("board.markers", Chunk(np.array([until]), rng.normal(size=(1, 4, 3)), until), until + 2_000_000)
            )
        at += m
    end = int(times[-1])
    return [*made, ("board.emg", empty(EMG, FOREVER), end + 3_000_000)]


SPECS = {"board.emg": EMG, "board.steps": STEP, "board.markers": MARKERS}


def record(path: Path, made: list[tuple[str, Chunk, int]], **options: Any) -> Recorder:
    wait, pause = options.pop("wait", True), options.pop("pause", 0.0)
    recorder = Recorder(
        path, {"graph": "nodes: {}\n", "session": {"subject": "S01"}}, RecordingOptions(**options), wait=wait
    )
    numbers = {name: recorder.add_stream(name, spec, "input") for name, spec in SPECS.items()}
    for sequence, (name, chunk, arrival) in enumerate(made):
        recorder.write(numbers[name], chunk, arrival, sequence)
        if pause and sequence % 20 == 0:
            time.sleep(pause)
    return recorder


def same(a: Chunk, b: Chunk) -> bool:
    return (
        a.time.tobytes() == b.time.tobytes()
        and a.data.tobytes() == b.data.tobytes()
        and (a.data.shape, a.data.dtype, a.until, a.lost) == (b.data.shape, b.data.dtype, b.until, b.lost)
    )


def assert_recorded(path: Path, made: list[tuple[str, Chunk, int]], after: int = -1) -> None:
    with Recording.open(path) as recording:
        found = list(recording.inputs(after))
    assert [f[0] for f in found] == list(range(after + 1, len(made)))
    for (_, name, chunk, arrival), (name_made, chunk_made, arrival_made) in zip(found, made[after + 1 :], strict=True):
        assert (name, arrival) == (name_made, arrival_made)
        assert same(chunk, chunk_made), (name, chunk, chunk_made)
        assert chunk.data.flags.writeable and chunk.data.flags.c_contiguous


@pytest.mark.parametrize("wait", [True, False])
@pytest.mark.parametrize("place", ["session", "one.mcap"])
def test_chunks_come_back_bit_for_bit_in_the_order_of_the_input_log(tmp_path: Path, place: str, wait: bool) -> None:
    made = session()
    record(tmp_path / place, made, wait=wait).close()
    assert_recorded(tmp_path / place, made)
    for after in (0, 5, len(made) // 2, len(made) - 2, len(made) - 1):
        assert_recorded(tmp_path / place, made, after)


def test_what_is_known_of_streams_without_reading_them(tmp_path: Path) -> None:
    made = session()
    record(tmp_path / "s", made).close()
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished
        assert recording.header["session"] == {"subject": "S01"}
        emg = [c for name, c, _ in made if name == "board.emg"]
        stream = recording.streams["board.emg"]
        assert stream.spec == EMG and stream.role == "input"
        assert stream.samples == 2000 == recording.last_samples("board.emg")
        assert stream.chunks == len(emg)
        assert stream.gaps == sum(c.lost != 0 for c in emg) > 3
        assert stream.lost == sum(max(c.lost, 0) for c in emg)
        assert (stream.first, stream.last, stream.until) == (START, START + 1_999_000_000, FOREVER)
        assert recording.last_sequence == len(made) - 1
        assert recording.end_of_inputs == made[-1][2]
        assert stream.rate_hz == pytest.approx(1000.0)
        times, data = recording.read("board.emg")
        assert data.dtype == np.float32
        assert np.array_equal(data[:, 0], np.arange(2000)) and np.array_equal(times, grid(1000.0, 2000, START))
        with pytest.raises(RecordingError, match=r"board.emgs.*did you mean 'board.emg'"):
            recording.read("board.emgs")


def test_log_and_metrics(tmp_path: Path) -> None:
    with Recorder(tmp_path / "s", {}, RecordingOptions()) as recorder:
        recorder.log("dropped", START, source="board", chunks=np.int64(3), level="warning")
        recorder.log("alarm", START + 1, text="stale")
        recorder.metrics(START + 2, {"envelope": {"p50_us": 2.5, "rate": np.float64(100.0)}})
    with Recording.open(tmp_path / "s") as recording:
        assert recording.log == [
            {"kind": "dropped", "time": START, "source": "board", "chunks": 3, "level": "warning"},
            {"kind": "alarm", "time": START + 1, "text": "stale"},
        ]
        assert list(recording.metrics()) == [{"time": START + 2, "table": {"envelope": {"p50_us": 2.5, "rate": 100.0}}}]


def test_other_programs_can_read_it_through_the_mcap_library(tmp_path: Path) -> None:
    made = session()
    recorder = record(tmp_path / "one.mcap", made)
    recorder.log("started", START)
    recorder.close()
    with (tmp_path / "one.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "kinegraph"
        summary = reader.get_summary()
        assert summary is not None
        assert {c.topic for c in summary.channels.values()} == {*SPECS, "kinegraph/log", "kinegraph/metrics"}
        schema = next(s for s in summary.schemas.values() if s.name == "kinegraph.board.emg")
        assert json.loads(schema.data)["channels"] == ["TA", "GM", "SOL"]
        lines = [json.loads(m.data) for s, c, m in reader.iter_messages(topics=["kinegraph/log"])]
        assert lines[0]["message"] == "started" and lines[0]["timestamp"]["sec"] == START // 10**9


def test_rotation_and_resumption_read_as_one(tmp_path: Path) -> None:
    made = session(seconds=4.0)
    half = len(made) // 2
    record(tmp_path / "s", made[:half], wait=False, pause=0.02, rotate_mb=0.005, flush_s=0.0, gather_s=0.005).close()
    first = len(list((tmp_path / "s").glob("session.*.mcap")))
    assert first > 2
    recorder = Recorder(tmp_path / "s", {}, RecordingOptions(), resume=True, wait=True)
    with Recording.open(tmp_path / "s") as before:
        ends = {name: before.last_samples(name) for name in SPECS}
    numbers = {name: recorder.add_stream(name, spec, "input", ends[name]) for name, spec in SPECS.items()}
    for sequence, (name, chunk, arrival) in enumerate(made[half:], half):
        recorder.write(numbers[name], chunk, arrival, sequence)
    recorder.close()
    assert_recorded(tmp_path / "s", made)
    assert_recorded(tmp_path / "s", made, half - 3)
    with Recording.open(tmp_path / "s") as recording:
        assert recording.streams["board.emg"].samples == recording.last_samples("board.emg") == 4000
        assert recording.streams["board.emg"].dropped == 0


def test_the_size_that_is_told_is_that_of_all_files_so_far(tmp_path: Path) -> None:
    options = RecordingOptions(rotate_mb=0.02, flush_s=0.0, gather_s=0.005)
    recorder = Recorder(tmp_path / "s", {}, options, wait=True)
    numbers = {name: recorder.add_stream(name, spec, "input") for name, spec in SPECS.items()}
    rows, parts = [0], set[int]()
    for sequence, (name, chunk, arrival) in enumerate(session(seconds=2.0)):
        recorder.write(numbers[name], chunk, arrival, sequence)
        if sequence % 10 == 0:
            recorder.flush()
            rows.append(recorder.status.bytes)
            parts.add(recorder.part)
            on_disk = sum(path.stat().st_size for path in (tmp_path / "s").glob("session.*.mcap"))
            assert rows[-1] <= on_disk <= rows[-1] + 20_000
    recorder.close()
    assert rows == sorted(rows) and len(parts) > 2
    assert recorder.status.bytes == sum(path.stat().st_size for path in (tmp_path / "s").glob("session.*.mcap"))


def test_a_place_is_taken_once(tmp_path: Path) -> None:
    recorder = record(tmp_path / "s", [])
    with pytest.raises(RecordingError, match="another kinegraph is recording there"):
        Recorder(tmp_path / "s", {}, RecordingOptions())
    recorder.close()
    assert [p.name for p in (tmp_path / "s").iterdir()] == ["session.0000.mcap"]
    with pytest.raises(RecordingError, match="already holds a recording"):
        Recorder(tmp_path / "s", {}, RecordingOptions())


def test_a_part_ends_before_its_index_fills_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.stream.recording.write.file_segments.MAX_SAVES", 3)
    made = session(seconds=4.0)
    record(tmp_path / "s", made, wait=False, pause=0.02, flush_s=0.0, gather_s=0.005).close()
    assert len(list((tmp_path / "s").glob("*.mcap"))) > 2
    assert_recorded(tmp_path / "s", made)


def test_a_session_that_outruns_the_clock_begins_a_file_every_quarter_of_an_hour_of_its_own_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the overviews of ten hours that pass in minutes would stand in memory."""
    monkeypatch.setattr("kinegraph.stream.recording.write.file_segments.MAX_S", 1.0)
    made = session(seconds=4.0)
    record(tmp_path / "live", made, wait=False, pause=0.02, flush_s=0.0, gather_s=0.005).close()
    assert len(list((tmp_path / "live").glob("*.mcap"))) > 2
    assert_recorded(tmp_path / "live", made)
    record(tmp_path / "import.mcap", made, wait=True, flush_s=0.0, gather_s=0.005).close()
    assert [path.name for path in tmp_path.glob("*.mcap")] == ["import.mcap"]


KILLED = """
import sys, time
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from tests.recordings.test_recording import record, session
made = session(seconds=5.0)
recorder = record(Path(sys.argv[2]), made[:-100], wait=False, flush_s=0.03, gather_s=0.01, pause=0.04)
while recorder.status.behind_s > 0 or recorder.status.bytes == 0:
    time.sleep(0.01)
print("written", flush=True)
time.sleep(60)
"""


def killed(path: Path) -> list[tuple[str, Chunk, int]]:
    """Record in another process, kill it when the disk has everything, and return what it recorded."""
    tests = str(Path(__file__).resolve().parents[2])
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, tests, str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "written\n"
        os.kill(process.pid, signal.SIGKILL)
    return session(seconds=5.0)[:-100]


def test_a_killed_process_leaves_a_recording_that_reads(tmp_path: Path) -> None:
    made = killed(tmp_path / "s")
    assert_recorded(tmp_path / "s", made)
    with Recording.open(tmp_path / "s") as recording:
        assert not recording.finished
    part = tmp_path / "s" / "session.0000.mcap"
    whole = part.read_bytes()
    for cut in (len(whole) - 1, len(whole) * 2 // 3, len(whole) // 2):
        part.write_bytes(whole[:cut])
        with Recording.open(tmp_path / "s") as recording:
            found = list(recording.inputs())
        assert 0 < len(found) <= len(made) - (cut < len(whole) * 0.9)
        assert all(same(f[2], m[1]) for f, m in zip(found, made, strict=False))


def test_files_that_are_no_recordings(tmp_path: Path) -> None:
    from mcap.writer import Writer

    made = session()
    record(tmp_path / "good.mcap", made).close()
    good = (tmp_path / "good.mcap").read_bytes()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("time,emg\n0,1\n")
    (tmp_path / "head.mcap").write_bytes(good[:60])
    (tmp_path / "new.mcap").write_bytes(
        good.replace(b"\x06\x00\x00\x00format\x01\x00\x00\x001", b"\x06\x00\x00\x00format\x01\x00\x00\x009", 1)
    )
    broken = bytearray(good)
    broken[len(good) // 3] ^= 0xFF
    (tmp_path / "broken.mcap").write_bytes(broken)
    with (tmp_path / "foreign.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "some robot")
        writer.finish()
    (tmp_path / "nothing").mkdir()
    for name, text in {
        "missing.mcap": "there is no such recording",
        "empty.mcap": "the file is empty",
        "text.mcap": "not an MCAP recording.*kinegraph files import",
        "head.mcap": "truncated before anything was recorded",
        "new.mcap": "written in recording format 9; this kinegraph reads formats up to 1",
        "foreign.mcap": "not a kinegraph recording .profile 'ros2'.",
        "nothing": "the folder holds no recording",
        "broken.mcap": "damaged at byte .*kinegraph recover",
    }.items():
        with pytest.raises(RecordingError, match=text) as caught, Recording.open(tmp_path / name) as recording:
            list(recording.inputs())
        assert name in str(caught.value)


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be created"):
        Recorder(tmp_path / "file" / "s", {}, RecordingOptions())


def test_a_chunk_of_the_wrong_shape_is_reported_and_costs_nothing_else(tmp_path: Path) -> None:
    made = session()
    recorder = record(tmp_path / "s", made[:50])
    recorder.write(2, Chunk(np.array([START]), np.zeros((1, 4)), START), START, 50)
    recorder.close()
    with Recording.open(tmp_path / "s") as recording:
        assert [line["kind"] for line in recording.log] == ["not recorded"]
        assert recording.streams["board.markers"].samples > 0


@pytest.mark.parametrize("owned", [False, True])
def test_an_input_is_copied_unless_its_memory_is_the_sessions_own(tmp_path: Path, owned: bool) -> None:
    spec = StreamSpec((8,), rate_hz=1000.0)
    samples = np.arange(1000 * 8, dtype=float).reshape(1000, 8)
    time = START + np.arange(1000) * 10**6
    with Recorder(tmp_path / "s", {}, RecordingOptions(gather_s=10.0), wait=True) as recorder:
        number = recorder.add_stream("board", spec, "input")
        recorder.write(number, Chunk(time, samples, int(time[-1])), START, 0, owned=owned)
        samples[0, 0] = -1.0  # what nobody may do with the session's own memory
    with Recording.open(tmp_path / "s") as recording:
        recorded = recording.read("board")[1]
    assert recorded[0, 0] == (-1.0 if owned else 0.0)
    assert np.array_equal(recorded[1:], samples[1:])


def test_nothing_written_after_close_raises(tmp_path: Path) -> None:
    recorder = record(tmp_path / "s", [])
    recorder.close()
    recorder.write(2, session()[0][1], START, 0)
    recorder.log("late", START)
    assert recorder.status.error == ""
    assert time.monotonic() > 0


def test_what_packs_well_is_read_again_however_much_comes_at_once(tmp_path: Path) -> None:
    """Zeros for 80 MB, in one chunk: they pack to a thousandth, and readers refuse what unpacks to so much from so little."""
    n, width = 10_000, 1000
    chunk = Chunk(grid(1e6, n), np.zeros((n, width)), FOREVER, 7)
    with Recorder(tmp_path / "r.mcap", {}, RecordingOptions(), wait=True) as recorder:
        recorder.write(recorder.add_stream("board", StreamSpec((width,), rate_hz=1e6), "input"), chunk, 1, 0)
    with Recording.open(tmp_path / "r.mcap") as back:
        pieces = [piece for _, _, piece, _ in back.inputs()]
    assert [piece.lost for piece in pieces] == [7] + [0] * (len(pieces) - 1) and pieces[-1].until == FOREVER
    assert all(a.until < b.time[0] for a, b in pairwise(pieces))
    assert np.array_equal(np.concatenate([piece.time for piece in pieces]), chunk.time)
    assert sum(piece.data.nbytes for piece in pieces) == chunk.data.nbytes and not any(p.data.any() for p in pieces)


def test_a_sample_that_no_reader_would_take_is_not_recorded(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r.mcap", {}, RecordingOptions(), wait=True)
    with recorder, pytest.raises(RecordingError, match=r"stream 'field': .* 40000000 bytes; at most 33554432 "):
        recorder.add_stream("field", StreamSpec((5_000_000,), np.dtype("f8")), "input")
