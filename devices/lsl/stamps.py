"""LSL's time stamps as session time: the sender's clock corrected, losses seen as leaps, never running backwards. No clock, no network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stream.chunk import NS, Samples, Times

SLEW = 1e-3
"""A new estimate of the sender's clock is taken over at this share of the pace of time, so that no stamp leaps."""
STEP_S = 0.05
"""A difference above this is no better estimate but another clock: it is taken over at once."""
EVEN = 0.25
"""A step between samples is even if it is within this share of a period."""
STEADY_S = 1.0
"""After so long with even steps alone, a leap by whole periods is that many samples lost."""
OLDEST_S, NEWEST_S = 3600.0, 10.0
"""A stamp further before its arrival, or further after, is not of LSL's clock."""


@dataclass(slots=True)
class Mapped:
    """The samples of one read.

    time         (n,) session time, ns; later than all before it, and never decreasing
    gaps         (index, lost) where samples are missing before it; -1: nobody knows how many
    backwards    how many stamps lay before an earlier one, and were moved to it
    impossible   how many stamps could not be of LSL's clock; their arrival is taken
    """

    time: Times
    gaps: list[tuple[int, int]]
    backwards: int
    impossible: int


class Stamps:
    """Maps one stream's stamps (s, on its sender's clock) to session time."""

    def __init__(self, rate_hz: float | None, zero_ns: int, gap_s: float = 0.5, latency_s: float = 0.0) -> None:
        """`zero_ns` is the session time of LSL's local clock at 0; `rate_hz` None: no leap is a loss."""
        self._zero, self._latency = zero_ns, round(latency_s * NS)
        self._leaps = Leaps(rate_hz, gap_s) if rate_hz else None
        self._target = self._correction = 0.0
        self._raw = -np.inf
        self._last: int | None = None

    def correct(self, correction_s: float, *, at_once: bool = False) -> None:
        """A new estimate of what to add to the sender's stamps to have local ones (s); `at_once` after a pause."""
        self._target = correction_s
        if at_once or abs(correction_s - self._correction) > STEP_S:
            self._correction = correction_s

    def map(self, stamps: Samples, arrival_ns: int, *, after_pause: bool = False) -> Mapped:
        """Session times of samples with these stamps (n,), n > 0, read at `arrival_ns`. `after_pause`: the connection was lost before."""
        stamps, impossible = self._possible(stamps, (arrival_ns - self._zero) / NS)
        gaps = self._leaps.before(stamps, after_pause=after_pause) if self._leaps else [(0, -1)] * after_pause
        times = np.round(stamps * NS).astype(np.int64) + np.round(self._corrections(stamps) * NS).astype(np.int64)
        times += self._zero - self._latency
        self._raw = float(stamps[-1])
        floors = np.maximum.accumulate(times)
        if self._last is not None:
            floors = np.maximum(floors, self._last + 1)
        self._last = int(floors[-1])
        return Mapped(floors, gaps, int((floors - times > 1000).sum()), impossible)

    def _possible(self, stamps: Samples, arrival_s: float) -> tuple[Samples, int]:
        """The stamps, the arrival in place of those that cannot be, and how many these are."""
        ages = arrival_s - stamps - self._correction
        wrong = ~((ages > -NEWEST_S) & (ages < OLDEST_S))
        if not wrong.any():
            return stamps, 0
        return np.where(wrong, arrival_s - self._correction, stamps), int(wrong.sum())

    def _corrections(self, stamps: Samples) -> Samples:
        """What to add to each stamp (s); towards the newest estimate, slowly."""
        rest = self._target - self._correction
        if not rest:
            return np.full(len(stamps), self._target)
        since = np.maximum(stamps - (self._raw if np.isfinite(self._raw) else stamps[0]), 0.0)
        made = self._correction + np.sign(rest) * np.minimum(abs(rest), SLEW * np.maximum.accumulate(since))
        self._correction = float(made[-1])
        return np.asarray(made)


class Leaps:
    """Where the stamps of a regular stream leap. LSL counts nothing, so this is all that can be known of a loss.

    A sender that stamps evenly loses a number of samples that can be told. One that stamps as it happens to get at its samples does not:
    its leaps are gaps only above `gap_s`, of unknown size.
    """

    def __init__(self, rate_hz: float, gap_s: float) -> None:
        self._period, self._gap = 1.0 / rate_hz, max(gap_s, 1.5 / rate_hz)
        self._last: float | None = None
        self._even_since = np.inf

    def before(self, stamps: Samples, *, after_pause: bool = False) -> list[tuple[int, int]]:
        """(index, lost) of the leaps before these samples (n,), n > 0."""
        if self._last is None:
            self._even_since = float(stamps[0])
        first = stamps[0] - self._period if self._last is None else self._last
        self._last = float(stamps[-1])
        steps = np.diff(stamps, prepend=first)
        periods = steps / self._period
        uneven = np.abs(periods - 1.0) > EVEN
        if after_pause:
            at = int(np.argmax(steps)) if uneven.any() else 0
            self._even_since = float(stamps[at])
            return [(at, -1)]
        return [gap for i in np.flatnonzero(uneven) if (gap := self._leap(int(i), stamps, steps, periods))]

    def _leap(self, i: int, stamps: Samples, steps: Samples, periods: Samples) -> tuple[int, int] | None:
        whole = round(float(periods[i]))
        before = float(stamps[i] - steps[i])
        if whole > 1 and abs(periods[i] - whole) <= EVEN and before - self._even_since >= STEADY_S:
            return i, whole - 1
        self._even_since = float(stamps[i])
        return (i, -1) if steps[i] > self._gap else None
