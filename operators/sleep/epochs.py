"""Activity by epochs: the counts, the mean motion or the peak of any activity stream, on a grid of sample time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.require import numeric
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param


@kernel
def gather(x: Samples, sums: Samples) -> None:
    """Take the samples `x` (n, c) into `sums` (4, c): the sum, the highest value, how many were finite, how many came."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            v = x[i, c]
            sums[3, c] += 1
            if abs(v) < math.inf:
                sums[0, c] += v
                sums[1, c] = max(sums[1, c], v) if sums[2, c] > 0 else v
                sums[2, c] += 1


@dataclass(slots=True)
class EpochsState:
    """
    sums    (4, c)  of the open epoch: sum, highest, how many were finite, how many came
    begin   start of the open epoch (ns); NEVER before the first
    silent  number of past epochs without a sample, and how many are filled at most
    needed  how many samples an epoch must have
    lost    what the next emission says is missing before it
    """

    epoch_ns: int
    offset_ns: int
    sums: Samples
    begin: int
    silent: int
    max_silent: int
    needed: float
    lost: int


@dataclass(frozen=True, slots=True)
class Epochs(Operator[EpochsState]):
    """A signal (channels,) in, one number per channel and epoch out, stamped with the epoch's start; known when the epoch is over.

    measure  sum: counts, of what was seen; mean: motion per sample; maximum: the highest sample. For Cole and Kripke's highest 10 s of a
             minute, put one of 10 s (sum) before one of 60 s (maximum)

    Epochs begin at whole multiples of `epoch_s` since 1970-01-01 UTC, plus `offset_s`, whatever the first sample's stamp. NaN: fewer than
    `min_seen` of the samples that the rate promises were there (irregular input: of those that came). A silence gives one
    NaN per epoch, up to `reset_gap_s`; beyond, nothing is emitted until samples come again. Delay: one epoch.

    >>> Epochs(epoch_s=2.0, measure="mean")(np.array([1.0, 3.0, 5.0, 7.0]), rate_hz=1, time=np.arange(4) * 10**9)
    array([2., 6.])
    """

    inputs = {"in": Input(rows=True)}
    epoch_s: float = param(30.0, above=0.0, help="length of an epoch")
    measure: Literal["sum", "mean", "maximum"] = param("sum", help="what becomes of an epoch's samples")
    min_seen: float = param(0.5, above=0.0, most=1.0, help="share of the samples that must have been seen")
    offset_s: float = param(0.0, help="how far the grid is from whole epochs since 1970")
    reset_gap_s: float = reset_gap(43_200.0, "a longer silence is not filled with unknown epochs")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        numeric(spec)
        if not spec.is_signal:
            raise InputError("in", spec.describe(), "a signal of channels")
        expected = (spec.rate_hz or 0.0) * self.epoch_s
        if spec.rate_hz and expected < 1 - 1e-6:
            raise ParameterError("epoch_s", self.epoch_s, f"at least {1 / spec.rate_hz:g} (one sample of the input)")
        epoch_ns = round(self.epoch_s * NS)
        most = int(self.reset_gap_s * NS) // epoch_ns
        sums = np.zeros((4, spec.shape[0]))
        needed = max(1.0, self.min_seen * expected - 1e-6)
        self.set_state(
            EpochsState(epoch_ns, round(self.offset_s * NS), sums, NEVER, 0, most, needed, 0), delay_s=self.epoch_s
        )
        named = f"{self.measure} of {1 / spec.rate_hz:g} s" if spec.rate_hz else self.measure
        meta = {**spec.meta, "measure": named, "epoch_s": self.epoch_s}
        return {"out": spec.derive(dtype=np.dtype(np.float64), rate_hz=1 / self.epoch_s, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        time = chunk.time
        emitted: list[tuple[str, Chunk]] = []
        made: list[tuple[int, Samples]] = []
        start = 0
        while start < len(time):
            t = int(time[start])
            again = self._pass(t - 1, made)
            if again or (chunk.lost and not start):
                emitted.append(("out", self._chunk(made, self._promise(t - 1))))
                made, s.lost = [], -1
            if s.begin == NEVER:
                s.begin = self._floor(t)
            stop = int(np.searchsorted(time, s.begin + s.epoch_ns))
            gather(chunk.data[start:stop], s.sums)
            s.silent = 0
            start = stop
        if chunk.until == FOREVER:
            self._end(made)
        elif self._pass(chunk.until, made):
            emitted.append(("out", self._chunk(made, self._promise(chunk.until))))
            made, s.lost = [], -1
        emitted.append(("out", self._chunk(made, self._promise(chunk.until))))
        return emitted

    def close(self) -> Chunk:
        made: list[tuple[int, Samples]] = []
        self._end(made)
        return self._chunk(made, FOREVER)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(21)
        frames = rng.gamma(0.3, 2.0, size=(600, 2))
        motion = StreamSpec((2,), rate_hz=10.0, channels=("left", "right"), units=("mm",))
        times = np.sort(rng.integers(10**9, 90 * 10**9, 300))
        pulses = StreamSpec((1,), channels=("wrist",), units=("counts",))
        return [
            Case(
                cls(epoch_s=2.0, measure="mean", reset_gap_s=30.0), {"in": (motion, grid(10.0, 600), frames)}, least=29
            ),
            Case(
                cls(epoch_s=2.0, measure="maximum", reset_gap_s=9.0),
                {"in": (motion, grid(10.0, 600), frames)},
                least=29,
            ),
            Case(cls(epoch_s=3.0, reset_gap_s=60.0), {"in": (pulses, times, np.ones((300, 1)))}, least=28),
        ]

    def _floor(self, time: int) -> int:
        s = self.state
        return (time - s.offset_ns) // s.epoch_ns * s.epoch_ns + s.offset_ns

    def _promise(self, until: int) -> int:
        """Whatever comes later belongs to the epoch of `until` + 1 or a later one."""
        return self._floor(until + 1) - 1 if NEVER < until < FOREVER else until

    def _pass(self, until: int, made: list[tuple[int, Samples]]) -> bool:
        """Close every epoch that is over by `until`; whether the silence has become too long to go on."""
        s = self.state
        while s.begin != NEVER and until >= s.begin + s.epoch_ns - 1:
            if not s.sums[2].any():
                s.silent += 1
            if s.silent > s.max_silent:
                s.begin, s.silent = NEVER, 0
                return True
            made.append((s.begin, self._row()))
            s.begin += s.epoch_ns
        return False

    def _end(self, made: list[tuple[int, Samples]]) -> None:
        s = self.state
        if s.begin != NEVER and s.sums[2].any():
            made.append((s.begin, self._row()))
        s.begin, s.silent = NEVER, 0

    def _row(self) -> Samples:
        """The open epoch's numbers; it is empty afterwards."""
        s = self.state
        total, highest, count, came = s.sums[0], s.sums[1], s.sums[2], s.sums[3]
        row: Samples = highest.copy() if self.measure == "maximum" else total.copy()
        if self.measure == "mean":
            row /= np.maximum(count, 1.0)
        row[(count < s.needed) | (count < self.min_seen * came)] = np.nan
        s.sums[:] = 0.0
        return row

    def _chunk(self, made: list[tuple[int, Samples]], until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        data = np.array([row for _, row in made]).reshape(len(made), s.sums.shape[1])
        return Chunk(np.array([t for t, _ in made], np.int64), data, until, lost)
