"""An input port that asks for rows gets contiguous float64, made once per edge; everyone else gets what flows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import Chunk, Specs, StreamSpec
from kinegraph.stream.data.rows import Rows, taking
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.laws import Choices, checks, trials
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.source import Feed, Source

SEEN: list[tuple[str, Chunk]] = []
POINTS = StreamSpec((2, 3), np.dtype(np.float32), 100.0, units=("m",))


@dataclass(frozen=True, slots=True)
class Points(Source):
    """Markers of float32."""

    def specs(self) -> Specs:
        return {"out": POINTS}

    def read(self, feed: Feed) -> None:
        """Fed by hand."""


class _Looks(Operator[None]):
    """Notes what it is given."""

    __slots__ = ()

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {"out": StreamSpec((1,))}

    def process(self, port: str, chunk: Chunk) -> None:
        SEEN.append((type(self).__name__, chunk))


@dataclass(frozen=True, slots=True)
class Rough(_Looks):
    """Takes what comes."""


@dataclass(frozen=True, slots=True)
class Smooth(_Looks):
    """Takes rows."""

    inputs = {"in": Input(rows=True)}


@dataclass(frozen=True, slots=True)
class Fine(_Looks):
    """Takes rows of finite numbers."""

    inputs = {"in": Input(finite=True)}


@dataclass(frozen=True, slots=True)
class Gain(Operator[None]):
    """Every number times `factor`: as short as a tutorial's."""

    inputs = {"in": Input(finite=True)}
    factor: float = 2.0

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {"out": specs["in"].derive(dtype=np.dtype(np.float64))}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        return Chunk(chunk.time, chunk.data * self.factor, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(1).normal(size=(200, 3))
        given = [StreamSpec((3,), np.dtype(kind), 100.0) for kind in (np.float64, np.float32, np.int16)]
        return [Case(cls(), {"in": (spec, grid(100.0, 200), data * 100)}, least=200) for spec in given]


GRAPH = f"""
nodes:
  body: {{use: {__name__}.Points}}
  rough: {{use: {__name__}.Rough, from: body}}
  smooth: {{use: {__name__}.Smooth, from: body}}
  again: {{use: {__name__}.Smooth, from: body}}
  fine: {{use: {__name__}.Fine, from: body}}
"""


def fed() -> tuple[Chunk, dict[str, list[Chunk]], list[Chunk]]:
    """A chunk of markers with a bad number; what each reader saw of it, and what a tap did."""
    made = Pipeline(load_text(GRAPH))
    tapped: list[Chunk] = []
    made.edges["body"].observers.append(tapped.append)
    made.compile()
    data = np.random.default_rng(2).normal(size=(4, 2, 3)).astype(np.float32)
    data[1, 1, 2] = np.inf
    chunk = Chunk(grid(100.0, 4), data, int(grid(100.0, 4)[-1]), 3)
    SEEN.clear()
    made.feed("body", chunk)
    return chunk, {name: [c for n, c in SEEN if n == name] for name in ("Rough", "Smooth", "Fine")}, tapped


def test_rows_are_made_once_for_all_who_ask() -> None:
    chunk, seen, tapped = fed()
    originals = [np.shares_memory(c.data, chunk.data) for c in (*seen["Rough"], *tapped)]
    assert originals == [True, True], "who does not ask has the original"
    one, other = seen["Smooth"]
    assert (
        np.shares_memory(one.data, other.data)
        and one.data.dtype == np.float64
        and one.data.shape == (4, 6)
        and one.data.flags.c_contiguous
    )
    assert (one.lost, one.until, np.shares_memory(one.time, chunk.time)) == (3, chunk.until, True)
    assert np.array_equal(one.data, chunk.data.reshape(4, 6).astype(np.float64))


def test_finite_rows_have_the_quiet_nan_for_what_is_not() -> None:
    chunk, seen, _ = fed()
    (found,) = seen["Fine"]
    expected = np.where(np.isfinite(chunk.data), chunk.data, np.nan).astype(np.float64)
    assert found.data.tobytes() == expected.tobytes() and np.isinf(seen["Smooth"][0].data).sum() == 1


@pytest.mark.parametrize("finite", [False, True])
def test_rows_of_finite_numbers_pass_untouched(finite: bool) -> None:
    spec = StreamSpec((3,), rate_hz=100.0)
    chunk = Chunk(grid(100.0, 5), np.ones((5, 3)), 0)
    assert Rows(spec, finite=finite)(chunk) is chunk


def test_events_are_left_as_they_are() -> None:
    event = StreamSpec((), np.dtype([("onset", "<i8")]))
    chunk = Chunk(np.zeros(1, np.int64), np.zeros(1, event.dtype), 0)
    assert taking(Smooth(), {"in": event})("in", chunk) is chunk


def test_a_gain_of_twelve_lines_obeys_every_law() -> None:
    made: list[Any] = [make() for make in trials(Gain)]
    assert len(made) == 3
    for trial in made:
        for check in checks(trial).values():
            check()
        for seed in range(10):
            trial.attempt(Choices(seed))
