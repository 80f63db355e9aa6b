"""What an epoch was for each sleeper: the time with movement, or why it cannot be judged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.bed.bed_events import IN, NAMES, OUT, UNKNOWN
from kinegraph.operators.bed.frames.light import LIGHT_S, STEADY, lit
from kinegraph.operators.bed.frames.noise import Noise
from kinegraph.stream.chunk import NS, Array, Samples, Times

LEAST_EPOCHS = 4
"""Fewer tell nothing of the noise."""
RESTLESS = 3.0
"""No noise in bed is this many times that of the empty bed, unless it has been as steady as noise is."""
STEADY_EPOCHS = 20
"""Over this many epochs noise scatters as little as within one (operators.bed.frames.light)."""
WHYS = np.array(["", "unseen", "dark", "camera", "still", "region", "body"])


@dataclass(frozen=True, slots=True)
class ActivityLimits:
    """What is decided by; see the parameters of `operators.bed.activity.Activity`.

    unasked   where a sleeper is (UNKNOWN, IN or OUT) before anything is known of it
    """

    sigmas: float
    min_rise: float
    min_s: float
    min_seen: float
    crosstalk_ratio: float
    unasked: int


@dataclass(slots=True)
class SleeperActivity:
    """
    bed, out        (k,) where each sleeper is; whether out of bed since the epoch's beginning
    in_bed, empty   noise while each sleeper is in bed, and while the bed is empty; far_bed: in bed, of the change over twice the time
    why             (k,) of WHYS: why a sleeper's place, or the source of movement, is unknown; moved: noise is learned again since a jump
    crowded         (k,) whether there was a second body at any time in the open epoch
    dark, jumped    whether the view is dark; whether there was darkness or a jump in the open epoch
    """

    sleepers: list[str]
    limits: ActivityLimits
    slot_ns: int
    bed: Times
    out: Times
    in_bed: Noise
    far_bed: Noise
    empty: Noise
    why: Times
    crowded: Times
    moved: bool
    dark: bool
    jumped: bool

    @staticmethod
    def unknown(sleepers: list[str], limits: ActivityLimits, slot_ns: int) -> SleeperActivity:
        k = len(sleepers)
        out, why, crowded = np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros(k, np.int64)
        noise = Noise.of(k), Noise.of(k), Noise.of(k)
        return SleeperActivity(
            sleepers, limits, slot_ns, np.full(k, limits.unasked), out, *noise, why, crowded, False, False, False
        )

    def look(self, what: str) -> None:
        """The view has become another one."""
        self.dark = what == "dark"
        self.jumped = self.jumped or what in ("dark", "moved")
        if what == "moved":
            self.moved = True
            self._forget_noise()

    def move(self, sleeper: str, state: str, why: str, throughout: bool = False) -> None:
        """Set whether a sleeper is in bed, out of it, or unknown; `throughout`: since the open epoch's beginning, though decided later."""
        if sleeper in self.sleepers:
            k = self.sleepers.index(sleeper)
            self.why[k] = int(np.flatnonzero(why == WHYS)[0]) if why in WHYS else 0
            self.crowded[k] = self.crowded[k] or why == "body"
            self.bed[k] = int(np.flatnonzero(state == NAMES)[0])
            self.out[k] = (self.out[k] or throughout) and self.bed[k] == OUT

    def forget(self) -> None:
        """Everything starts again."""
        self.moved = self.jumped = False
        self.why[:] = self.crowded[:] = 0
        self.bed[:] = self.limits.unasked
        self._forget_noise()

    def _forget_noise(self) -> None:
        for noise in (self.in_bed, self.far_bed, self.empty):
            noise.clear()

    def begin(self) -> None:
        """An epoch begins."""
        self.out[:] = self.bed == OUT

    def end(
        self, onset: int, end: int, change: Samples, far: Samples, seen: Samples
    ) -> list[tuple[float, tuple[Any, ...]]]:
        """An epoch is over, and the next begins. For each sleeper: activity, and the event.

        change, far  (slots, k) averages, and those over twice the time; NaN: not seen
        seen         (k,) share of the frames
        """
        limits = np.array([self._limit(k, change[:, k], far[:, k]) for k in range(len(self.sleepers))])
        made = []
        for k, sleeper in enumerate(self.sleepers):
            moved_s, crosstalk, activity, why = self._judge(k, change, far, limits, float(seen[k]))
            where = NAMES[self.bed[k]]
            event = (onset, end, sleeper, moved_s, min(float(seen[k]), 1.0), where, crosstalk, limits[k], why)
            made.append((activity, event))
        self.jumped = self.dark
        self.begin()
        self.crowded[:] = WHYS[self.why] == "body"
        return made

    def _limit(self, k: int, change: Samples, far: Samples) -> float:
        """Learn from the epoch's averages (slots,) of a sleeper, and give the threshold (mm); NaN: not known."""
        finite = change[np.isfinite(change)]
        if 2 * len(finite) > len(change) and not self.jumped:
            if self.bed[k] == IN:
                self.in_bed.learn(k, finite)
                if np.isfinite(far).any():
                    self.far_bed.learn(k, far[np.isfinite(far)])
            elif self.out[k]:
                self.empty.learn(k, finite)
        if self.in_bed.count[k] < LEAST_EPOCHS:
            return math.nan
        limit = self.in_bed.threshold(k, self.limits.sigmas, self.limits.min_rise)
        if self.empty.count[k] < LEAST_EPOCHS or self.in_bed.steady(k, STEADY, STEADY_EPOCHS):
            return limit
        return min(limit, RESTLESS * self.empty.level_of(k))

    def _judge(
        self, k: int, change: Array, far: Array, limits: Samples, seen: float
    ) -> tuple[float, float, float, str]:
        """Of a sleeper's epoch: time with movement (s), share that may be another's, activity, and why it cannot be judged."""
        slot_s = self.slot_ns / NS
        moving = change[:, k] > limits[k]
        light = self._lit(k, change[:, k], far[:, k], moving)
        moving &= ~light
        there = np.isfinite(change[:, k]) & ~light
        moved_s = float(moving.sum()) * slot_s if limits[k] == limits[k] else math.nan
        excess = change - limits
        strongest = np.fmax.reduce(np.delete(excess, k, axis=1), axis=1, initial=-math.inf)
        theirs = moving & (strongest > self.limits.crosstalk_ratio * excess[:, k])
        crosstalk = float(theirs.sum() / moving.sum()) if moving.any() else 0.0
        own_s = moved_s - float(theirs.sum()) * slot_s
        why = self._why(k, seen, float(light.mean()), moved_s, own_s)
        if why:
            activity = math.nan
        elif self.out[k]:
            activity = 1.0
        else:
            activity = own_s / (float((there & ~theirs).sum()) * slot_s) if not own_s < self.limits.min_s else 0.0
        return moved_s, crosstalk, activity, why

    def _lit(self, k: int, change: Samples, far: Samples, moving: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which of the averages (slots,) in movement are only noise that has risen."""
        if not moving.any() or not self.far_bed.count[k]:
            return np.zeros(len(change), np.bool_)
        n = math.ceil(LIGHT_S * NS / self.slot_ns)
        level, scatter = self.in_bed.level_of(k), self.in_bed.scatter_of(k)
        return lit(change, far, moving, n, level, scatter, self.far_bed.level_of(k))

    def _why(self, k: int, seen: float, light: float, moved_s: float, own_s: float) -> str:
        """Why the epoch cannot be judged; "": it can. `own_s` of the movement is surely this sleeper's."""
        min_seen, min_s = self.limits.min_seen, self.limits.min_s
        known = moved_s == moved_s
        self.moved = self.moved and not (known and self.in_bed.count.min() >= LEAST_EPOCHS)
        if self.jumped:
            return "dark" if self.dark else "camera"
        if self.bed[k] == UNKNOWN:
            unknown = "camera" if self.moved else "unseen" if seen < min_seen else "learning"
            return str(WHYS[self.why[k]]) or unknown
        if seen < min_seen:
            return "unseen"
        if self.out[k]:
            return ""
        if not known:
            return "camera" if self.moved else "learning"
        if light > 1 - min_seen:
            return "light"
        shared = bool(self.crowded[k]) or own_s < min_s
        return "body" if shared and moved_s >= min_s else ""
