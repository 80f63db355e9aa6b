"""Replay is live: a session with drops, a late source and a parameter change gives the same bits from its recording."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import parts
import pytest

from kinegraph.stream.chunk import Chunk
from kinegraph.stream.engine.flow.queues import Drops
from kinegraph.stream.engine.replay import Digest, Replay
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support import SUPPORT

EVENTFUL = """
record: [sum, loud, both, aside, hurried]
nodes:
  one: {use: parts.Counting, samples: 2500, realtime: true, queue: 3, policy: drop_oldest, chunk: 5, key: one}
  two: {use: parts.Counting, samples: 2000, realtime: true, trouble: pauses, pause_s: 0.8, at: 300, patience_s: 0.2, key: two}
  three: {use: parts.Counting, samples: 1500, realtime: true, trouble: dies, at: 400, key: three}
  volume: {use: stream.manual.Value, initial: 1.0}
  sum: {use: parts.RunningSum, from: one, slow_s: 0.008}
  loud: {use: parts.Gain, from: {signal: two, gain: volume}}
  both: {use: parts.Beside, from: {a: sum, b: loud}}
  hurried: {use: parts.RunningSum, from: two, slow_s: 0.03, worker: slow, queue: 3, policy: drop_oldest}
  aside: {use: parts.Beside, from: {a: hurried, b: three}}
"""


@pytest.fixture(autouse=True)
def _clean() -> None:
    parts.seen.clear()
    parts.openings.clear()


def graph_of(text: str, recording: Recording | None = None) -> Graph:
    specs = {n: s.spec for n, s in recording.streams.items()} if recording else None
    return load_text(text, path=str(SUPPORT / "graph.yaml"), recorded=specs)


def test_a_session_with_drops_a_late_source_and_a_changed_value_replays_bit_for_bit(tmp_path: Path) -> None:
    session = Session(graph_of(EVENTFUL), tmp_path / "s")

    def person() -> None:
        for value in ("2.5", "-1", "7"):
            time.sleep(0.5)
            session.tell("volume", value)
            session.mark(f"now {value}")

    thread = threading.Thread(target=person)
    thread.start()
    outcome = session.run()
    thread.join()
    assert outcome.error is None
    assert outcome.table["one"]["dropped"] > 0
    assert outcome.table["two"]["late"] > 0
    assert outcome.table["hurried"]["dropped"] > 0
    assert outcome.table["three"]["openings"] == 2
    with Recording.open(tmp_path / "s") as recording:
        result = Replay(graph_of(EVENTFUL, recording), recording).run()
        assert set(result.digests) == {"sum", "loud", "both", "aside", "hurried"}
        assert result.differing == []
        assert min(recording.streams[name].samples for name in result.digests) > 100
        assert result.compiled == []


def test_a_replay_can_be_recorded_and_replayed_again(tmp_path: Path) -> None:
    Session(graph_of(EVENTFUL), tmp_path / "s", duration_s=1.0).run()
    with Recording.open(tmp_path / "s") as recording:
        first = Replay(graph_of(EVENTFUL, recording), recording, output=tmp_path / "again.mcap").run()
    with Recording.open(tmp_path / "again.mcap") as again:
        second = Replay(graph_of(EVENTFUL, again), again).run()
        assert second.differing == []
        for name, (_, replayed) in first.digests.items():
            assert second.digests[name][1] == replayed


def test_outlets_are_silent_in_replay_unless_asked(tmp_path: Path) -> None:
    text = """
nodes:
  board: {use: parts.Counting}
  a: {use: parts.Collect, from: board, name: a}
  b: {use: parts.Collect, from: board, name: b}
"""
    Session(graph_of(text), tmp_path / "s").run()
    parts.seen.clear()
    with Recording.open(tmp_path / "s") as recording:
        Replay(graph_of(text, recording), recording, speaking={"b"}).run()
    assert parts.numbers("a") == []
    assert parts.numbers("b") == list(range(1000))


def test_a_replay_keeps_a_chosen_pace(tmp_path: Path) -> None:
    text = "nodes:\n  board: {use: parts.Counting, samples: 1200, realtime: true}\n  out: {use: parts.Collect, from: board}\n"
    Session(graph_of(text), tmp_path / "s").run()
    with Recording.open(tmp_path / "s") as recording:
        result = Replay(graph_of(text, recording), recording, speed=4.0).run()
    assert result.took_s >= 0.28


def test_samples_beyond_those_recorded_are_a_difference(tmp_path: Path) -> None:
    text = "record: [high.onset]\nnodes:\n  board: {use: parts.Counting}\n"
    text += "  high: {use: operators.filters.threshold.Threshold, from: board, level: %s, channel: 0}\n"
    Session(graph_of(text % 1e9), tmp_path / "s").run()
    with Recording.open(tmp_path / "s") as recording:
        assert recording.streams["high.onset"].samples == 0
        assert Replay(graph_of(text % 1e9, recording), recording).run().differing == []
        assert Replay(graph_of(text % 500, recording), recording).run().differing == ["high.onset"]


def test_a_changed_parameter_shows_as_a_difference(tmp_path: Path) -> None:
    text = "record: [low]\nnodes:\n  board: {use: parts.Counting}\n  low: {use: operators.Lowpass, from: board, cutoff_hz: %d}\n"
    Session(graph_of(text % 20), tmp_path / "s").run()
    with Recording.open(tmp_path / "s") as recording:
        assert Replay(graph_of(text % 20, recording), recording).run().differing == []
        assert Replay(graph_of(text % 21, recording), recording).run().differing == ["low"]


def test_a_digest_does_not_depend_on_cuts() -> None:
    time_ns, data = np.arange(10), np.random.default_rng(0).standard_normal((10, 3))
    whole, cut = Digest(), Digest()
    whole.add(Chunk(time_ns, data, 9))
    for a, b in ((0, 3), (3, 3), (3, 10)):
        cut.add(Chunk(time_ns[a:b], data[a:b], 9))
    assert whole.hexdigest() == cut.hexdigest()
    cut.add(Chunk(time_ns[:0], data[:0], 10))
    assert whole.hexdigest() == cut.hexdigest()


def test_drops_are_repeated_by_sample_whatever_the_chunks() -> None:
    def left_out(sizes: list[int]) -> tuple[list[int], dict[int, int]]:
        drops, kept, marks, at = Drops([(3, 4), (7, 1), (12, 2)]), [], {}, 0
        for n in sizes:
            times = np.arange(at, at + n)
            chunk = drops.repeat(Chunk(times, times[:, None] * 1.0, at + n - 1))
            if chunk.lost:
                marks[int(chunk.time[0])] = chunk.lost
            kept += chunk.time.tolist()
            at += n
        return kept, marks

    assert left_out([20]) != ([], {})
    for sizes in ([20], [1] * 20, [4, 4, 4, 4, 4], [13, 7]):
        kept, marks = left_out(sizes)
        assert kept == [0, 1, 2, 8, 9, 10, 11, 14, 15, 16, 17, 18, 19]
        assert sum(marks.values()) == 7
