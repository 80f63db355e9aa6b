"""The breathing movement of a sleeper's chest as a signal, tick by tick, and the pauses in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
FORGETS = 0.3
"""How much of the usual movement each epoch with a rate replaces."""
NEAR = 2.5
"""Breaths per minute around a rate that belong to it."""


@dataclass(slots=True)
class BreathWave:
    """
    level      (cells,)       slow depth of each cell (mm); NaN: not seen yet
    chosen     (k, cells)     1 and -1: cells that rise and fall with the chest, 0 the others
    newest     (k, n)         the signal of the newest epoch, a ring by the number of the tick
    tick       the newest tick since 1970; NEVER: no tick yet
    usual      (k,)           how far the chest moves within a span (mm); 0: not known
    low        (k,)           for how many ticks it has moved too little
    pauses, paused (k,)       pauses that ended in this epoch, and their length (s)
    """

    level: Samples
    chosen: Samples
    newest: Samples
    tick: int
    usual: Samples
    low: Times
    pauses: Times
    paused: Samples

    @staticmethod
    def of(k: int, cells: int, n: int) -> BreathWave:
        return BreathWave(
            np.full(cells, np.nan), np.zeros((k, cells)), np.full((k, n), np.nan), NEVER, np.zeros(k), np.zeros(k, np.int64),
            np.zeros(k, np.int64), np.zeros(k),
        )  # fmt: skip

    def add(self, depth: Samples, tick: int, tick_s: float) -> Samples:
        """The depths (cells,) of a tick. Returns how far each sleeper's chest is risen (k,), mm; NaN: not known."""
        if self.tick == NEVER or (tick - self.tick) * tick_s > 2 * HIGHPASS_S:
            self.level[:] = np.nan
            self.newest[:] = np.nan
            self.low[:] = 0
        self.tick = tick
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
        self._watch(tick, tick_s)
        return wave

    def _watch(self, tick: int, tick_s: float) -> None:
        """Whether the chest has moved in the newest span; a pause is counted once it is over."""
        n, span = self.newest.shape[1], max(2, round(SPAN_S / tick_s))
        recent = _smooth(self.newest[:, (tick - np.arange(min(span, n))) % n], tick_s)
        for k, moved in enumerate(np.ptp(recent, axis=1).tolist()):
            if not (moved == moved and self.usual[k]):
                self.low[k] = 0
            elif moved < LOW * self.usual[k]:
                self.low[k] += 1
            else:
                length = self.low[k] * tick_s + MISSED_S
                if self.low[k] and length >= PAUSE_S:
                    self.pauses[k] += 1
                    self.paused[k] += length
                self.low[k] = 0

    def learn(self, k: int, ticks: Samples, cells: Times, tick_s: float) -> None:
        """The cells (some of all) that breathe most in an epoch in which breath is seen, and their depths in it (n, cells).

        How far the chest usually moves is taken from the cells of the epoch before: the best of this one hold its noise, too.
        """
        x = np.where(np.isfinite(ticks), ticks, np.nanmean(ticks, axis=0))
        x = x - x.mean(axis=0)
        lead = x @ np.sign(x.T @ x[:, 0])
        signs = np.sign(lead @ x)
        self.chosen[k] = 0.0
        self.chosen[k, cells] = signs * (1.0 if signs.sum() >= 0 else -1.0)
        span, n = max(2, round(SPAN_S / tick_s)), self.newest.shape[1]
        before = self.newest[k, (self.tick - np.arange(n)[::-1]) % n]
        mean = _smooth((before if np.isfinite(before).all() else x @ signs / len(cells))[None], tick_s)[0]
        moved = np.median([np.ptp(mean[i : i + span]) for i in range(0, max(1, len(mean) - span), 2)])
        self.usual[k] += (FORGETS if self.usual[k] else 1.0) * (float(moved) - self.usual[k])

    def halts(self, k: int, tick_s: float) -> bool:
        """Whether a pause is in the newest epoch: a rate of what is left would be that of no breath."""
        return bool(self.paused[k] + (self.low[k] * tick_s + MISSED_S) * (self.low[k] > 0) >= PAUSE_S)

    def sized(self, k: int, rate: float, tick_s: float) -> tuple[float, float]:
        """Of the newest epoch: how far the chest rises (mm, 5th to 95th percentile), and the share of its movement at this rate."""
        n = self.newest.shape[1]
        x = self.newest[k, (self.tick - np.arange(n)[::-1]) % n]
        x = x[np.isfinite(x)]
        if len(x) < 0.8 * n or rate != rate:
            return math.nan, math.nan
        low, high = np.percentile(x, (5, 95))
        power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)))) ** 2
        per_min = 60 * np.fft.rfftfreq(len(x), tick_s)
        width = max(NEAR, per_min[1])  # short epochs have frequencies far apart
        near = (np.abs(per_min - rate) <= width) | (np.abs(per_min - 2 * rate) <= width)
        return float(high - low), float(power[near].sum() / max(power[per_min > NEAR].sum(), 1e-12))

    def forget(self, k: int) -> None:
        """The sleeper has left."""
        self.chosen[k], self.usual[k], self.low[k] = 0.0, 0.0, 0


def _smooth(x: Samples, tick_s: float) -> Samples:
    """Means (k, n) of neighbouring ticks of x (k, n + width - 1): noise that is smaller than breath must not hide a pause."""
    width = max(1, round(SMOOTH_S / tick_s))
    sums = np.cumsum(np.pad(x, ((0, 0), (1, 0))), axis=1)
    means: Samples = (sums[:, width:] - sums[:, :-width]) / width
    return means
