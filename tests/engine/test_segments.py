"""Operators in a row as one function: the same samples, counts and states as one by one, whatever comes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from kinegraph.operators.filters.rectify import Rectify
from kinegraph.operators.filters.scale import straight_line
from kinegraph.stream.chunk import FOREVER, Array, Chunk, empty
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph.reading.load import load_text

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false}
  choose: {use: operators.filters.channels.Select, from: board.emg, channels: [2, 0, 1]}
  centre: {use: operators.filters.mean.RemoveMean, from: choose, window_s: 0.05}
  rectify: {use: operators.filters.rectify.Rectify, from: centre}
  lowpass: {use: operators.filters.iir.Lowpass, from: rectify, cutoff_hz: 20}
  thin: {use: operators.filters.decimate.Decimate, from: lowpass, every: 7}
  mean: {use: operators.filters.moving.MovingMean, from: thin, window_s: 0.05}
  scale: {use: operators.filters.scale.Scale, from: mean, gain: 0.5}
  events: {use: operators.filters.threshold.Threshold, from: scale, level: 0.2, channel: 0}
"""
START = 10**18


def delivery(seed: int, width: int) -> list[Chunk]:
    """Chunks of all sizes, with gaps that are held and gaps that reset, bad samples, and pauses."""
    random = np.random.default_rng(seed)
    now, made = START, []
    for _ in range(60):
        n = int(random.choice([0, 1, 3, 10, 40, 200]))
        lost = int(random.choice([0] * 8 + [5, 500]))
        now += lost * 10**6
        time = now + np.arange(n) * 10**6
        now += n * 10**6
        data = random.normal(size=(n, width))
        if n and random.random() < 0.2:
            data[random.integers(n), random.integers(width)] = random.choice([np.nan, np.inf])
        made.append(Chunk(time, data, now - 10**6, lost if n else 0))
    return [*made, Chunk(np.empty(0, np.int64), np.empty((0, width)), FOREVER)]


def fed(made: Pipeline, chunks: list[Chunk], *, written: bool = True) -> list[tuple[Array, Array, int, int]]:
    """Feed copies of these, with segments `written` out or step by step, and what came out behind the last operator, in order."""
    out: list[tuple[Array, Array, int, int]] = []
    edge = made.edges["scale"]
    edge.observers.append(lambda c: out.append((c.time.copy(), c.data.copy(), c.until, c.lost)))
    if written:
        made.compile()
    for c in chunks:
        made.feed("board.emg", Chunk(c.time.copy(), c.data.copy(), c.until, c.lost))
    edge.observers.pop()
    return out


def alike(one: list[tuple[Array, Array, int, int]], other: list[tuple[Array, Array, int, int]]) -> bool:
    return [(t.tobytes(), d.tobytes(), u, k) for t, d, u, k in one] == [
        (t.tobytes(), d.tobytes(), u, k) for t, d, u, k in other
    ]


def states(made: Pipeline) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in made.snapshot().items()}


@pytest.mark.parametrize("seed", range(6))
def test_a_segment_gives_what_its_operators_give(seed: int) -> None:
    plain, joined = (Pipeline(load_text(GRAPH)) for _ in range(2))
    chunks = delivery(seed, plain.entries["board.emg"].spec.shape[0])
    one, other = fed(plain, chunks, written=False), fed(joined, chunks)
    assert len(joined.segments) < len(joined.stages)
    assert len(one) > 20 and alike(one, other)
    assert states(plain) == states(joined)  # and with them what passed every wire, gaps and losses


def test_a_restored_segment_goes_on_where_the_other_was() -> None:
    whole, first, second = (Pipeline(load_text(GRAPH)) for _ in range(3))
    chunks = delivery(9, whole.entries["board.emg"].spec.shape[0])
    expected = fed(whole, chunks)
    got = fed(first, chunks[:25])
    second.restore(first.snapshot())
    got += fed(second, chunks[25:])
    assert alike(expected, got)


@dataclass(frozen=True, slots=True)
class Slip(Rectify):
    """Names a kernel that wants more than the state has."""

    kernel = straight_line


@dataclass(frozen=True, slots=True)
class Stampless(Rectify):
    """Thins out without stamps."""

    def rows(self, n: int) -> int:
        return n // 2


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ("Slip", "the kernel of Slip is to be given 'line', which is neither a field of its state nor a parameter"),
        ("Stampless", "Stampless leaves samples out .`rows`., so its kernel must be given `stamps`"),
    ],
)
def test_a_slip_in_a_declaration_names_the_node(part: str, message: str) -> None:
    text = GRAPH.replace("operators.filters.rectify.Rectify", f"tests.engine.test_segments.{part}")
    with pytest.raises(GraphError, match=f"node 'rectify': {message}"):
        load_text(text)


@pytest.mark.parametrize("how", ["apart", "read-only"])
def test_arrays_that_no_kernel_takes_are_made_normal_first(how: str) -> None:
    plain, joined = (Pipeline(load_text(GRAPH)) for _ in range(2))
    joined.compile()
    width = plain.entries["board.emg"].spec.shape[0]
    time, data = START + np.arange(80) * 10**6, np.random.default_rng(2).normal(size=(80, width))
    if how == "apart":
        time, data = time[::2], data[::2]
    else:
        time.flags.writeable = data.flags.writeable = False
    for made in (plain, joined):
        made.feed("board.emg", Chunk(time, data, int(time[-1])))
    assert states(plain) == states(joined)


def test_time_alone_passes_a_segment() -> None:
    made = Pipeline(load_text(GRAPH))
    got = fed(made, [empty(made.entries["board.emg"].spec, START)])
    assert [u < START for _, _, u, _ in got] == [True]
