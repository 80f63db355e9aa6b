"""The breathing movement of a sleeper's chest as a signal, tick by tick, and the pauses in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kinegraph.operators.bed.breath import BEST
from kinegraph.stream.chunk import NEVER, Samples, Times

HIGHPASS_S = 2.7
"""Time constant of each cell's level: half of the power is kept at 3.5 breaths per minute, 97 % of the lift at 15."""
SPAN_S = 5.0
"""Breath is seen in how far the chest moves within this time."""
SMOOTH_S = 0.75
LOW = 0.35
"""Less than this part of the usual movement is no effort that can be seen."""
MISSED_S = 3.7
"""A pause is this much longer than the time in which the newest span moves too little."""
PAUSE_S = 10.0
SPIKE_S = SPAN_S + 1.0
"""One outlier moves the span for so long, a breath for longer: pauses that are no farther apart are one."""
FORGETS = 0.3
"""How much of the usual movement each epoch with a rate replaces."""
ROUNDED, ARMED = 0.1, 0.1
"""Breaths are counted in a wave smoothed over a fifth of a breath; one begins after it was this part of its range below the median."""
MISCOUNTED = 0.5
"""A count that is off by as much of a breath as this or more is not believed."""
NEAR = 2.5
"""Breaths per minute around a rate that belong to it."""
ENOUGH = 0.8
"""This share of the ticks must be known; ticks are skipped where frames are lost."""


@dataclass(slots=True)
class BreathWave:
    """
    level      (cells,)       slow depth of each cell (mm); NaN: not seen yet
    chosen     (k, cells)     1 and -1: cells that rise and fall with the chest, 0 the others
    newest     (k, n)         the signal of the newest epoch, a ring by the number of the tick; NaN: not known, or no frame
    tick       the newest tick since 1970; NEVER: no tick yet
    usual      (k,)           how far the chest moves within a span (mm); 0: not known
    low        (k,)           for how many ticks it has moved too little
    ended      (k,)           the tick at which the newest pause ended
    pauses, paused (k,)       pauses that ended in this epoch, and their length (s)
    """

    level: Samples
    chosen: Samples
    newest: Samples
    tick: int
    usual: Samples
    low: Times
    ended: Times
    pauses: Times
    paused: Samples

    @staticmethod
    def of(k: int, cells: int, n: int) -> BreathWave:
        return BreathWave(
            np.full(cells, np.nan), np.zeros((k, cells)), np.full((k, n), np.nan), NEVER, np.zeros(k), np.zeros(k, np.int64),
            np.full(k, NEVER), np.zeros(k, np.int64), np.zeros(k),
        )  # fmt: skip

    def add(self, depth: Samples, tick: int, tick_s: float) -> Samples:
        """The depths (cells,) of a tick. Returns how far each sleeper's chest is risen (k,), mm; NaN: not known."""
        if self.tick == NEVER or (tick - self.tick) * tick_s > 2 * HIGHPASS_S:
            self.level[:] = np.nan
            self.newest[:] = np.nan
            self.low[:] = 0
            self.tick = tick - 1
        step, self.tick = tick - self.tick, tick
        self.newest[:, np.arange(tick - step + 1, tick) % self.newest.shape[1]] = np.nan
        finite = np.isfinite(depth)
        fresh = ~np.isfinite(self.level) & finite
        self.level[fresh] = depth[fresh]
        self.level[finite] += (1 - math.exp(-tick_s / HIGHPASS_S)) * (depth[finite] - self.level[finite])
        risen = np.where(finite, self.level - depth, 0.0)
        used = np.abs(self.chosen) @ finite
        with np.errstate(invalid="ignore", divide="ignore"):
            wave: Samples = np.where(used >= BEST / 3, self.chosen @ risen / used, np.nan)
        n = self.newest.shape[1]
        self.newest[:, tick % n] = wave
        self._watch(tick, step, tick_s)
        return wave

    def _watch(self, tick: int, step: int, tick_s: float) -> None:
        """Whether the chest has moved in the newest span, `step` ticks after the last look; a pause is counted once it is over."""
        n, span = self.newest.shape[1], max(2, round(SPAN_S / tick_s))
        recent = _smooth(self.newest[:, (tick - np.arange(min(span, n))) % n], tick_s)
        known = np.isfinite(recent).mean(axis=1) >= ENOUGH
        spans = np.where(known, np.fmax.reduce(recent, axis=1) - np.fmin.reduce(recent, axis=1), np.nan)
        for k, moved in enumerate(spans.tolist()):
            if not (moved == moved and self.usual[k]):
                self.low[k] = 0
            elif moved < LOW * self.usual[k]:
                self.low[k] += step
            else:
                length = float(self.low[k]) * tick_s + MISSED_S
                if self.low[k] and length >= PAUSE_S:
                    since_s = (tick - int(self.ended[k])) * tick_s
                    same = since_s - float(self.low[k]) * tick_s <= SPIKE_S
                    self.pauses[k] += not same
                    self.paused[k] += since_s if same else length
                    self.ended[k] = tick
                self.low[k] = 0

    def learn(self, k: int, ticks: Samples, cells: Times, rate: float, tick_s: float) -> None:
        """The cells (some of all) that breathe most in an epoch in which breath is seen, at this `rate`, and their depths in it (n, cells).

        Which of them rise and fall together shows at the rate itself: any one of them may be mostly noise. How far the chest usually moves
        is taken from the cells of the epoch before: the best of this one hold its noise, too.
        """
        x = np.where(np.isfinite(ticks), ticks, np.nanmean(ticks, axis=0))
        x = x - x.mean(axis=0)
        at = (np.exp(-2j * np.pi * rate / 60 * tick_s * np.arange(len(x))) * np.hanning(len(x))) @ x
        signs = np.sign((at * np.exp(-0.5j * np.angle((at**2).sum()))).real)
        self.chosen[k] = 0.0
        self.chosen[k, cells] = signs * (1.0 if signs.sum() >= 0 else -1.0)
        span, before = max(2, round(SPAN_S / tick_s)), self._epoch(k)
        mean = _smooth((x @ signs / len(cells) if before is None else before)[None], tick_s)[0]
        moved = np.median([np.ptp(mean[i : i + span]) for i in range(0, max(1, len(mean) - span), 2)])
        self.usual[k] += (FORGETS if self.usual[k] else 1.0) * (float(moved) - self.usual[k])

    def halts(self, k: int, tick_s: float) -> bool:
        """Whether a pause is in the newest epoch: a rate of what is left would be that of no breath."""
        return bool(self.paused[k] + (self.low[k] * tick_s + MISSED_S) * (self.low[k] > 0) >= PAUSE_S)

    def sized(self, k: int, rate: float, tick_s: float) -> tuple[float, float]:
        """Of the newest epoch: how far the chest rises (mm, 5th to 95th percentile), and the share of its movement at this rate."""
        x = self._epoch(k)
        if x is None or rate != rate:
            return math.nan, math.nan
        low, high = np.percentile(x, (5, 95))
        power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)))) ** 2
        per_min = 60 * np.fft.rfftfreq(len(x), tick_s)
        width = max(NEAR, per_min[1])  # short epochs have frequencies far apart
        near = (np.abs(per_min - rate) <= width) | (np.abs(per_min - 2 * rate) <= width)
        return float(high - low), float(power[near].sum() / max(power[per_min > NEAR].sum(), 1e-12))

    def counted(self, k: int, rate: float, error: float, tick_s: float) -> float:
        """The rate (1/min) of the breaths in the newest epoch, from the first one's beginning to the last one's; else `rate`, by spectrum.

        A spectrum weighs the middle of the epoch most: where breaths differ in length, that is not their mean. It is kept where both agree
        to its `error`, and where the count is off by more than `MISCOUNTED`: the wave is too noisy for it.
        """
        x = self._epoch(k)
        if x is None:
            return rate
        begins = _begins(x, 60 / rate / tick_s)
        if len(begins) < 3:
            return rate
        mean = 60 * (len(begins) - 1) / ((begins[-1] - begins[0]) * tick_s)
        return mean if error < abs(mean - rate) < MISCOUNTED * rate / len(begins) else rate

    def _epoch(self, k: int) -> Samples | None:
        """The newest epoch (n,), straight lines where ticks are not known; None where too few are."""
        n = self.newest.shape[1]
        x = self.newest[k, (self.tick - np.arange(n)[::-1]) % n]
        known = np.isfinite(x)
        if known.mean() < ENOUGH:
            return None
        made: Samples = x if known.all() else np.interp(np.arange(n), np.flatnonzero(known), x[known])
        return made

    def forget(self, k: int) -> None:
        """The sleeper has left."""
        self.chosen[k], self.usual[k], self.low[k], self.ended[k] = 0.0, 0.0, 0, NEVER


def _begins(x: Samples, period: float) -> Samples:
    """Where, between its ticks, x (n,) rises through its median, once it was well below; breaths take about `period` ticks."""
    width = 2 * round(ROUNDED * period) + 1
    smooth = np.convolve(np.pad(x, width // 2, mode="reflect"), np.full(width, 1 / width), mode="valid")
    smooth = smooth - np.median(smooth)
    low, high = np.percentile(smooth, (10, 90))
    begins, below = [], False
    for i, (before, here) in enumerate(pairwise(smooth.tolist())):
        below = below or before < -ARMED * (high - low)
        if below and before < 0 <= here:
            begins.append(i - before / (here - before))
            below = False
    return np.array(begins)


def _smooth(x: Samples, tick_s: float) -> Samples:
    """Means (k, n) of what is known of neighbouring ticks of x (k, n + width - 1): noise smaller than breath must not hide a pause."""
    width = max(1, round(SMOOTH_S / tick_s))
    known = np.isfinite(x)
    sums, counts = (np.cumsum(np.pad(v, ((0, 0), (1, 0))), axis=1) for v in (np.where(known, x, 0.0), known))
    with np.errstate(invalid="ignore"):
        means: Samples = (sums[:, width:] - sums[:, :-width]) / (counts[:, width:] - counts[:, :-width])
    return means
