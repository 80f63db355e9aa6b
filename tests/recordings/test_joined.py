"""A fast replay reads long chunks: the samples, stamps and gaps of the recorded ones, and the same promises at their ends."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from kinegraph.stream.chunk import NS, Chunk, StreamSpec, add_lost
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.read.joined import joinable, joined

MARK = np.dtype([("onset", "<i8"), ("text", "U8")])
SPECS = {
    "board": StreamSpec((3,), rate_hz=100.0),
    "marks": StreamSpec((), MARK),
}


def record(path: Path, seed: int, parts: int = 1) -> None:
    """Random chunks of both streams, some empty, some after a gap, over about six seconds."""
    random = np.random.default_rng(seed)
    recorder = Recorder(path, {"graph": ""}, RecordingOptions(rotate_mb=0.0), wait=True)
    numbers = {name: recorder.add_stream(name, spec, "input") for name, spec in SPECS.items()}
    now = dict.fromkeys(SPECS, NS)
    for sequence in range(600):
        name = "board" if random.random() < 0.7 else "marks"
        n = int(random.integers(0, 5)) if name == "board" else int(random.random() < 0.2)
        time = now[name] + np.arange(n) * 10_000_000
        lost = int(random.choice([0, 0, 0, 0, 0, 0, 2, -1])) if random.random() < 0.3 else 0
        data = random.normal(size=(n, 3)) if name == "board" else np.array([(int(t), "step") for t in time], MARK)
        until = int(time[-1]) if n else now[name]
        now[name] = until + 10_000_000
        recorder.write(numbers[name], Chunk(time, data, until, lost), NS + sequence * 10_000_000, sequence)
    recorder.close()


def content(chunks: list[Chunk]) -> tuple[bytes, bytes, dict[int, int], int]:
    """Samples, stamps, what was lost before which sample, and the last promise."""
    gaps: dict[int, int] = {}
    at = 0
    for chunk in chunks:
        if chunk.lost:
            gaps[at] = add_lost(gaps.get(at, 0), chunk.lost)
        at += len(chunk)
    data, time = b"".join(c.data.tobytes() for c in chunks), b"".join(c.time.tobytes() for c in chunks)
    return data, time, gaps, chunks[-1].until


def test_joined_chunks_hold_what_was_recorded(tmp_path: Path) -> None:
    for seed in range(8):
        path = tmp_path / f"{seed}.mcap"
        record(path, seed)
        with Recording.open(path) as recording:
            taken: dict[str, list[Chunk]] = {name: [] for name in SPECS}
            for _, name, chunk, _ in joined(recording, set(SPECS)):
                taken[name].append(chunk)
            for name in SPECS:
                plain = list(recording.chunks(name))
                assert content(taken[name]) == content(plain)
                assert len(taken[name]) < len(plain) / 2


def test_promises_hold_for_every_joined_chunk(tmp_path: Path) -> None:
    record(tmp_path / "r.mcap", 3)
    with Recording.open(tmp_path / "r.mcap") as recording:
        promised = dict.fromkeys(SPECS, 0)
        for _, name, chunk, _ in joined(recording, set(SPECS)):
            if len(chunk):
                assert chunk.time[0] > promised[name]
                assert chunk.until >= chunk.time[-1]
                chunk.data[:] = chunk.data  # the memory may be written
            assert chunk.until >= promised[name]
            promised[name] = chunk.until


def test_streams_stay_side_by_side_in_time(tmp_path: Path) -> None:
    record(tmp_path / "r.mcap", 4)
    with Recording.open(tmp_path / "r.mcap") as recording:
        arrivals = [arrival for _, _, _, arrival in joined(recording, set(SPECS))]
    assert all(later > earlier - 2 * NS for earlier, later in itertools.pairwise(arrivals))


def test_frames_are_not_joined() -> None:
    assert not joinable(StreamSpec((4, 6), np.dtype("<u2")))
    assert joinable(StreamSpec((5, 3)))
    assert all(map(joinable, SPECS.values()))


def test_a_gap_is_before_its_first_sample_and_time_has_come_up_to_it(tmp_path: Path) -> None:
    """So that an alarm that time alone brings about comes before the gap, however long the chunks are."""
    record(tmp_path / "r.mcap", 5)
    with Recording.open(tmp_path / "r.mcap") as recording:
        until = dict.fromkeys(SPECS, 0)
        gaps = 0
        for _, name, chunk, _ in joined(recording, set(SPECS)):
            if chunk.lost and len(chunk):  # without samples: behind the last one
                gaps += 1
                assert until[name] == chunk.time[0] - 1
            until[name] = chunk.until
        assert gaps > 10
