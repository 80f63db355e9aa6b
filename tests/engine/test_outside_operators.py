"""Arrays given to an operator from outside: it cannot write to them, and may keep them and give them back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import parts
import pytest

from kinegraph.stream.chunk import Array, Chunk
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.errors import RunError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import Emitted
from kinegraph.stream.params import param

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false}
  rectify: {use: operators.filters.rectify.Rectify, from: board.emg}
  lowpass: {use: operators.filters.iir.Lowpass, from: rectify, cutoff_hz: 20}
  guest: {use: tests.engine.test_outside_operators.Guest, from: lowpass, how: %s}
  mean: {use: operators.filters.moving.MovingMean, from: guest, window_s: 0.05}
  scale: {use: operators.filters.scale.Scale, from: mean, gain: 0.5}
"""
DIRECT = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false}
  guest: {use: tests.engine.test_outside_operators.Guest, from: board.emg}
"""
START = 10**18
kept: list[Chunk] = []


@dataclass(frozen=True, slots=True)
class Guest(parts.Identity):
    """From outside; keeps all that it was given."""

    how: str = param("")

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if len(chunk) and chunk.time[0] >= START:
            kept.append(chunk)
            if self.how == "writes" and len(kept) == 30:
                chunk.data[:] = 0.0
            if self.how == "writes later" and len(kept) == 30:
                kept[3].data[:] = 0.0
        given: dict[str, Emitted] = {
            "the chunk": chunk,
            "its arrays": Chunk(chunk.time, chunk.data, chunk.until, chunk.lost),
            "its samples": Chunk(chunk.time.copy(), chunk.data, chunk.until, chunk.lost),
            "its stamps": Chunk(chunk.time, chunk.data.copy(), chunk.until, chunk.lost),
            "a list": [("out", chunk)],
        }
        return given.get(self.how, chunk)


def answers(how: str, *, written: bool) -> tuple[Array, Array]:
    made = Pipeline(load_text(GRAPH % how, path=__file__))
    out: list[Chunk] = []
    made.edges["scale"].observers.append(out.append)
    if written:
        made.compile()
    kept.clear()
    random = np.random.default_rng(3)
    for i in range(60):
        time = START + np.arange(i * 10, i * 10 + 10) * 10**6
        data = random.normal(size=(10, made.entries["board.emg"].spec.shape[0]))
        made.feed("board.emg", Chunk(time, data, int(time[-1]), 7 if i % 20 == 9 else 0))
    return np.concatenate([chunk.time for chunk in out]), np.concatenate([chunk.data for chunk in out])


@pytest.mark.parametrize("how", ["the chunk", "its arrays", "its samples", "its stamps", "a list"])
def test_an_operator_from_outside_may_keep_what_it_is_given_and_give_it_on(how: str) -> None:
    plain = answers(how, written=False)
    taken = [(chunk.time.copy(), chunk.data.copy()) for chunk in kept]
    lent = answers(how, written=True)
    assert all(np.array_equal(one, other) for one, other in zip(plain, lent, strict=True))
    assert not any(chunk.time.flags.writeable or chunk.data.flags.writeable for chunk in kept)
    for (time, data), chunk in zip(taken, kept, strict=True):
        assert np.array_equal(time, chunk.time) and np.array_equal(data, chunk.data)


@pytest.mark.parametrize("how", ["writes", "writes later"])
@pytest.mark.parametrize("written", [False, True])
def test_it_cannot_write_to_it_now_or_later(how: str, written: bool) -> None:
    with pytest.raises(RunError, match=r"node 'guest': .* is read-only"):
        answers(how, written=written)
    assert len(kept) == 30


def test_stamps_that_come_in_steps_are_put_together_before_the_first_operator() -> None:
    made = Pipeline(load_text(DIRECT, path=__file__))
    made.compile()
    kept.clear()
    width = made.entries["board.emg"].spec.shape[0]
    for i in range(3):
        time = (START + np.arange(i * 20, i * 20 + 20) * 10**6)[::2]
        made.feed("board.emg", Chunk(time, np.ones((10, width)), int(time[-1])))
        assert kept[-1].time.flags.c_contiguous and np.array_equal(kept[-1].time, time)
