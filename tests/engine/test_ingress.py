"""The two ways of a source's chunks into the graph, inline and queued: whatever comes, they give the same."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import numpy as np
import parts
import pytest
from parts import START

from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec
from kinegraph.stream.engine.ingress import Bursts, GraphTurn, Ingress, IngressPort, _gathering
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.engine.supervisor import Inline, not_inline
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.params import param
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.checkpoint import Checkpoint
from kinegraph.stream.source import Feed, Source

SPEC = StreamSpec((2,), rate_hz=1000.0, channels=("number", "wave"))
SHAPES = ("as it should be", "a view", "float32", "read-only", "a list")


@dataclass(frozen=True, slots=True)
class Untidy(Source):
    """Chunks that are late, run backwards, say nothing, or come in other arrays than they should."""

    seed: int = param(0)

    @property
    def live(self) -> bool:
        return False

    def specs(self) -> Specs:
        return {"out": SPEC}

    def read(self, feed: Feed) -> None:
        feed.emit(Chunk(np.array([START]), np.zeros((1, 2)), START))
        feed.wait(0.4)  # by then the session has begun, and chunks go in inline
        for chunk in chunks(self.seed):
            feed.emit(chunk)
            feed.wait(0.002)


def chunks(seed: int) -> list[Chunk]:
    random = np.random.default_rng(seed)
    made, now = [], START + 1
    for i in range(120):
        n = int(random.integers(0, 4)) if random.random() < 0.8 else 100
        times = now + np.sort(random.integers(0, 5 * n + 1, n))
        kind = random.choice(("in order", "in order", "in order", "late", "backwards", "gap"))
        if kind == "late":
            times -= 40
        elif kind == "backwards" and n > 2:
            times[n // 2] -= 30
        until = int(times.max(initial=now)) + int(random.integers(-3, 3))
        numbers = np.stack([np.full(n, i), np.arange(n)], axis=1).astype(float)
        made.append(Chunk(times, shaped(numbers, random.choice(SHAPES)), until, 5 if kind == "gap" else 0))
        now = max(now, until + 1, *times.tolist())
    return made


def shaped(data: Array, shape: str) -> Any:
    if shape == "a view":
        return np.repeat(data, 2, axis=1)[:, ::2]
    if shape == "read-only":
        data.flags.writeable = False
    return (
        {"float32": data.astype(np.float32), "a list": data.reshape(-1, 2).tolist()}.get(shape, data)
        if len(data)
        else data
    )


save = Checkpoint.save

NODES = """
nodes:
  board: {use: tests.engine.test_ingress.Untidy, seed: %d, patience_s: 0}
  same: {use: parts.Identity, from: board}
  out: {use: parts.Collect, from: same, policy: block}
"""


def run(seed: int, folder: Path) -> tuple[Outcome, list[tuple[Any, ...]]]:
    """The outcome, and what entered the graph: every chunk with its place in the input log."""
    parts.seen.clear()
    outcome = Session(load_text(NODES % seed, path=str(Path(__file__))), folder).run()
    with Recording.open(folder) as recording:
        entered = [
            (e.chunk.time.tolist(), e.chunk.data.tolist(), e.chunk.until, e.chunk.lost)
            for e in recording.entries("board")
        ]
    return outcome, entered


@pytest.mark.parametrize("seed", range(3))
def test_both_ways_give_the_same(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[bool] = []
    build = Ingress.inline

    def watched(self: Ingress, port: IngressPort) -> Inline:
        way = build(self, port)

        def take(chunk: Chunk, arrival: int) -> bool:
            taken.append(way(chunk, arrival))
            return taken[-1]

        return take

    monkeypatch.setattr(Ingress, "inline", watched)
    short, by_inline = run(seed, tmp_path / "short")
    seen = [(c.time.tolist(), c.data.tolist(), c.lost) for c in parts.seen["out"] if len(c)]
    monkeypatch.setattr(Ingress, "inline", lambda *_: not_inline)
    long, by_queues = run(seed, tmp_path / "long")
    assert short.exit_code == long.exit_code == 0, (short.error, long.error)
    assert 20 < sum(taken) < len(taken)
    assert by_inline == by_queues
    assert seen == [(c.time.tolist(), c.data.tolist(), c.lost) for c in parts.seen["out"] if len(c)]
    for name in ("late", "lost", "gaps", "samples", "problems"):
        assert short.table["board"][name] == long.table["board"][name]


def test_where_nobody_waits_only_samples_enter(tmp_path: Path) -> None:
    """Annotations without readers: no chunk of the input log says that nothing was typed."""
    outcome, _ = run(0, tmp_path / "s")
    assert outcome.exit_code == 0
    with Recording.open(tmp_path / "s") as recording:
        assert [e.chunk for e in recording.entries("annotations") if e.chunk.until < 2**62] == []


@dataclass(frozen=True, slots=True)
class Hasty(Untidy):
    """The same, many more, without a pause: a burst. Then it waits until the last chunk has come through the graph, and may fail."""

    fails: bool = param(False)

    @property
    def live(self) -> bool:
        return True

    def read(self, feed: Feed) -> None:
        if self.fails and "hasty" in parts.openings:
            return
        parts.openings["hasty"] = 1
        feed.emit(Chunk(np.array([START]), np.zeros((1, 2)), START))
        feed.wait(0.4)
        made = [chunk for part in range(20) for chunk in later(chunks(self.seed + part), part)]
        for chunk in made:
            feed.emit(chunk)
        if self.fails:
            raise OSError("unplugged")
        end = max(chunk.until for chunk in made)
        while not feed.stopped and parts.seen["out"][-1].until < end:
            feed.wait(0.001)


def later(made: list[Chunk], part: int) -> list[Chunk]:
    """The chunks `part` milliseconds later, and a hundred good ones behind them."""
    shift = part * 10**6
    moved = [Chunk(np.asarray(c.time) + shift, c.data, c.until + shift, c.lost) for c in made]
    at = START + shift + 500_000
    good = [np.arange(at + 100 * i, at + 100 * i + 50, 10) for i in range(100)]
    return moved + [Chunk(time, np.full((5, 2), i), int(time[-1])) for i, time in enumerate(good)]


def joined(entries: list[tuple[Any, ...]]) -> list[tuple[int, list[float], int]]:
    """Every sample: its stamp, its values, and how many are missing before it."""
    samples, missing = [], 0
    for times, data, _, lost in entries:
        missing += lost
        for stamp, values in zip(times, data, strict=True):
            samples.append((stamp, values, missing))
            missing = 0
    return samples


@pytest.mark.parametrize("seed", range(3))
def test_a_burst_enters_together_and_is_the_same(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "NODES", NODES.replace("Untidy", "Hasty"))
    together, gathered = run(seed, tmp_path / "together")
    assert together.exit_code == 0, together.error
    seen = [(c.time.tolist(), c.data.tolist(), c.until, c.lost) for c in parts.seen["out"]]
    monkeypatch.setattr(Ingress, "inline", lambda *_: not_inline)
    monkeypatch.setattr("kinegraph.stream.engine.ingress.BURST", 10**9)
    alone, one_by_one = run(seed, tmp_path / "alone")
    assert alone.exit_code == 0, alone.error
    assert len(gathered) < 0.8 * len(one_by_one)
    assert joined(gathered) == joined(one_by_one) == joined(seen)
    for name in ("late", "lost", "gaps", "samples", "problems"):
        assert together.table["board"][name] == alone.table["board"][name]


@dataclass(frozen=True, slots=True)
class Slow(parts.Identity):
    """Takes its time with one chunk, on that one's source's thread, and says so."""

    def process(self, port: str, chunk: Chunk) -> Chunk:
        if START + 1 in chunk.time:
            BUSY.set()
            DONE.wait(10.0)
        return chunk


@dataclass(frozen=True, slots=True)
class Waking(Source):
    """Two chunks: the second one sets a slow operator to work."""

    def specs(self) -> Specs:
        return {"out": SPEC}

    def read(self, feed: Feed) -> None:
        feed.emit(Chunk(np.array([START]), np.zeros((1, 2)), START))
        feed.wait(0.4)
        feed.emit(Chunk(np.array([START + 1]), np.zeros((1, 2)), START + 1))


@dataclass(frozen=True, slots=True)
class Flooding(Waking):
    """Two hundred chunks while somebody else has the turn."""

    def read(self, feed: Feed) -> None:
        feed.emit(Chunk(np.array([START]), np.zeros((1, 2)), START))
        assert BUSY.wait(100.0)
        for i in range(1, 200):
            feed.emit(Chunk(np.array([START + i]), np.full((1, 2), i, float), START + i))
        DONE.set()


BUSY, DONE = threading.Event(), threading.Event()

BESIDE = """
nodes:
  board: {use: tests.engine.test_ingress.Flooding, patience_s: 0}
  other: {use: tests.engine.test_ingress.Waking, patience_s: 0}
  slow: {use: tests.engine.test_ingress.Slow, from: other}
  out: {use: parts.Collect, from: board, policy: block}
record: [slow]
"""


def test_what_waits_while_another_has_the_turn_enters_together(tmp_path: Path) -> None:
    parts.seen.clear()
    outcome = Session(load_text(BESIDE, path=str(Path(__file__))), tmp_path / "s").run()
    assert outcome.exit_code == 0, outcome.error
    with Recording.open(tmp_path / "s") as recording:
        entered = [e.chunk for e in recording.entries("board") if len(e.chunk)]
        assert np.array_equal(recording.read("board")[1][:, 0], np.arange(200.0))
    assert np.array_equal(np.concatenate([c.data[:, 0] for c in parts.seen["out"]]), np.arange(200.0))
    assert len(entered) < 10


class Gathered:
    """A source's port in a session with a free turn; `entered` says how many chunks entered together."""

    def __init__(self) -> None:
        self.queue = SimpleNamespace(gathered=deque(), limit=256)
        self.supervisor: Any = SimpleNamespace(state="running", inline={})
        self.queue.depth = 0
        self.output, self.gathers, self.last = "out", True, time.monotonic()
        self.turn, self.entered = GraphTurn(open=True), list[int]()
        nothing: Any = SimpleNamespace(idle_hint=lambda: None, port=None)
        me: Any = self
        self.gather = _gathering(me, me, lambda *_: True, 0, nothing, nothing, lambda _: None)

    def enter_together(self, port: Any) -> int:
        self.entered.append(len(self.queue.gathered))
        self.queue.gathered.clear()
        return 0

    def give(self, *came: int) -> None:
        chunk = Chunk(np.zeros(1, np.int64), np.zeros((1, 2)), 0)
        for at in came:
            self.queue.depth = len(self.queue.gathered) + 1
            self.gather(chunk, at)


def test_one_pause_of_a_sources_thread_does_not_end_a_burst() -> None:
    port, ms = Gathered(), 10**6
    port.give(*range(0, 128_000, 1000))
    assert port.entered == [128] and port.gathers
    port.give(20 * ms, *range(20 * ms + 1, 20 * ms + 129))
    assert port.entered == [128, 1, 128] and port.gathers, "as its next chunks come at once"
    port.give(40 * ms, 60 * ms)
    assert port.entered == [128, 1, 128, 1, 1] and not port.gathers


def test_a_burst_is_over_when_nothing_was_gathered_between_two_looks() -> None:
    woken: Any = SimpleQueue()
    port: Any = Gathered()
    bursts = Bursts(woken)
    bursts.begin(port, not_inline)
    port.queue.gathered.append("a chunk")
    assert list(bursts.over()) == [], "one has entered just now"
    port.last -= 1.0
    assert list(bursts.over()) == [port] and port.gathers
    port.queue.gathered.clear()
    assert list(bursts.over()) == [] and not port.gathers and bursts.ports == []


def test_of_a_burst_before_a_failure_nothing_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts.openings.clear()
    monkeypatch.setattr(sys.modules[__name__], "NODES", nodes := NODES.replace("Untidy", "Hasty"))
    _, whole = run(0, tmp_path / "whole")
    parts.openings.clear()
    monkeypatch.setattr(sys.modules[__name__], "NODES", nodes.replace("seed", "fails: true, seed"))
    outcome, before = run(0, tmp_path / "fails")
    assert outcome.exit_code == 0, outcome.error
    assert joined(before) == joined(whole)


@dataclass(frozen=True, slots=True)
class Wrong(parts.Counting):
    """Says once, when chunks go in inline, up to when it is complete in a way that is no time."""

    def read(self, feed: Feed) -> None:
        first = not parts.openings
        parts.openings["wrong"] = 1
        feed.emit(Chunk(np.array([feed.now()]), np.zeros((1, 2)), feed.now()))
        feed.wait(0.5)
        now = feed.now()
        feed.emit(Chunk(np.array([now]), np.zeros((1, 2)), "now" if first else now))  # type: ignore[arg-type]


def test_a_chunk_that_is_no_chunk_fails_its_source_not_the_session(tmp_path: Path) -> None:
    parts.openings.clear()
    graph = load_text(
        NODES.replace("tests.engine.test_ingress.Untidy, seed: %d", "tests.engine.test_ingress.Wrong, realtime: true"),
        path=__file__,
    )
    outcome = Session(graph, tmp_path / "s").run()
    assert outcome.exit_code == 0, outcome.error
    with Recording.open(tmp_path / "s") as recording:
        kinds = [
            line["kind"] for line in recording.log if line["kind"] not in ("silent source advanced", "stream is stale")
        ]  # which come on a slow machine
        assert kinds == ["source failed", "source reopened", "source ended"]
        assert recording.streams["board"].samples == 3


@dataclass(frozen=True, slots=True)
class NumpyTimes(parts.Counting):
    """Says up to when it is complete in numpy's integers."""

    def read(self, feed: Feed) -> None:
        for _ in range(100):
            now = np.array([feed.now()])
            feed.emit(Chunk(now, np.zeros((1, 2)), now[-1]))
            feed.wait(0.01)


def test_times_in_numpys_integers_can_be_checkpointed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Checkpoint] = []
    monkeypatch.setattr(Checkpoint, "save", lambda self, folder: (save(self, folder), kept.append(self)))
    text = "checkpoint_s: 0.2" + NODES.replace(
        "tests.engine.test_ingress.Untidy, seed: %d", "tests.engine.test_ingress.NumpyTimes, realtime: true"
    )
    assert Session(load_text(text, path=__file__), tmp_path / "s").run().exit_code == 0
    assert any(checkpoint.promised["board"] > 0 for checkpoint in kept)


def test_a_stream_that_has_gone_stale_is_reported_once_until_it_comes_back() -> None:
    options, queue = SimpleNamespace(stale_s=2.0, patience_s=0.5), SimpleNamespace(policy="block", depth=0, name="emg")
    source, node = SimpleNamespace(background=False, continues=False), SimpleNamespace(options=options)
    runner: Any = SimpleNamespace(live=True, queues={"out": queue}, node=node, source=source)
    edge: Any = SimpleNamespace(readers=[1], spec=SPEC)
    port, output = IngressPort(runner, "out", edge), list[str]()
    made = [
        port.nothing_for(age, START + k, lambda what, **_: output.append(what)) for k, age in enumerate((1, 1, 3, 4))
    ]
    assert output == ["silent source advanced", "stream is stale"]
    assert [chunk.until - START for chunk in made if chunk is not None] == [k - 500_000_000 for k in range(4)]
