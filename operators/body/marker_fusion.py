"""Takes the surer of two ways to see a body: a network where available, depth alone otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.body.bones import possible
from kinegraph.operators.body.names import MARKERS
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

PARTS = tuple(
    tuple((MARKERS.index(f"left_{name}"), MARKERS.index(f"right_{name}")) for name in names)
    for names in (("ear", "shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "heel", "toe"))
)
"""Left and right markers of the arms, with the head's, and of the legs."""
CLEARLY = 2.0
"""Two ways agree on left and right if their markers are this number of times nearer to each other than with these exchanged."""


@dataclass(slots=True)
class SurerState:
    """
    newest   (markers, 3)  what the second way saw, and at which stamp
    at       that stamp
    first    whether the first way is believed now
    streak   samples in a row that speak for the other one
    """

    newest: Samples
    at: int
    first: bool
    streak: int


@dataclass(frozen=True, slots=True)
class Surer(Operator[SurerState]):
    """Markers by two ways in, those of the surer one out: a sample for every one of `first`.

    first   markers (points, 3), NaN where one is missing
    second  the same markers of the same moments by another way: its sample of the same stamp counts

    A way is as sure as it sees markers. `first` is taken as long as it sees `least` of them; when it has not for `patience` samples in a
    row, or sees nothing at all, `second` is, until `first` is back for as many. A marker that `first` misses is taken from `second`
    where both agree on which arm, or leg, is the left one, and the bones to those of `first` are then as long as bones are; else it
    stays missing.

    >>> given, made = tried(Surer)
    >>> np.isfinite(given["first"]).mean().round(2).item(), np.isfinite(made).mean().round(2).item()
    (0.75, 0.98)
    """

    inputs = {"first": Input(trigger=True), "second": Input()}

    least: int = param(8, least=1, help="how many markers `first` must see")
    fill: bool = param(True, help="whether a marker that `first` misses may come from `second`")
    patience: int = param(3, least=1, help="samples in a row before the other way is taken")

    def open(self, specs: Specs) -> Specs:
        first, second = specs["first"], specs["second"]
        if len(first.shape) != 2 or first.shape[1] != 3 or first.dtype.kind != "f":
            raise InputError("first", first.describe(), "markers (points, 3)")
        if second.shape != first.shape or second.channels != first.channels or second.units != first.units:
            raise InputError("second", second.describe(), f"the same markers as `first`: {first.describe()}")
        if self.fill and first.channels != MARKERS:
            raise ParameterError("fill", True, "false for other markers than those of operators.body")
        self.set_state(SurerState(np.full(first.shape, np.nan), -1, True, 0))
        return {"out": first.derive(settling_s=max(first.settling_s, second.settling_s))}

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        s = self.state
        if port == "second":
            if len(chunk):
                s.newest[:], s.at = only_finite(chunk.data[-1]), int(chunk.time[-1])
            return None
        out = only_finite(chunk.data).astype(chunk.data.dtype)
        for i, time in enumerate(chunk.time.tolist()):
            sees = int(np.isfinite(chunk.data[i]).all(axis=1).sum()) >= self.least
            s.streak = s.streak + 1 if sees != s.first else 0
            if s.streak >= self.patience:
                s.first, s.streak = sees, 0
            if not s.first or (s.at == time and np.isnan(out[i]).all()):
                out[i] = s.newest if s.at == time else np.nan
            elif s.at == time and self.fill:
                _fill(out[i], s.newest)
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random, n = np.random.default_rng(5), 90
        first, second = random.normal(size=(2, n, len(MARKERS), 3))
        first[30:60, 5:] = np.nan
        spec = StreamSpec((len(MARKERS), 3), rate_hz=30.0, channels=MARKERS, units=("m",))
        times = grid(30.0, n)
        given = {"first": (spec, times, first), "second": (spec, times, second)}
        other = {"first": (spec.derive(channels=()), times, first), "second": (spec.derive(channels=()), times, second)}
        some = {"first": (spec, times, first), "second": (spec, times[::2], second[::2])}
        return [
            Case(cls(), given, least=n),
            Case(cls(patience=1), some, least=n),
            Case(cls(fill=False), other, least=n),
        ]


def _fill(out: Samples, other: Samples) -> None:
    """What is missing in `out` (20, 3) from `other`, as far as the bones allow."""
    missing: NDArray[np.bool_] = np.array(~np.isfinite(out).all(axis=1))
    if not missing.any():
        return
    other = np.where(_agreed(out, other)[:, None], other, np.nan)
    both = np.where(missing[:, None], other, out)
    allowed = possible(1.0, both)
    out[missing & allowed] = other[missing & allowed]


def _agreed(first: Samples, second: Samples) -> NDArray[np.bool_]:
    """For each marker (20,) whether both ways (20, 3) take the same arm, or leg, for the left one, by the pairs that both see."""
    agreed = np.array([not name.startswith(("left_", "right_")) for name in MARKERS])
    for part in PARTS:
        straight = crossed = 0.0
        for left, right in part:
            pair, twin = [left, right], [right, left]
            if np.isfinite(first[pair]).all() and np.isfinite(second[pair]).all():
                straight += float(np.linalg.norm(first[pair] - second[pair], axis=1).sum())
                crossed += float(np.linalg.norm(first[pair] - second[twin], axis=1).sum())
        for both in part:
            agreed[list(both)] = crossed > CLEARLY * straight
    return agreed
