"""LSL's time stamps as session time: the sender's clock corrected, losses seen as leaps, never running backwards. No clock, no network."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from kinegraph.stream.chunk import NS, Samples, Times

SLEW = 1e-3
"""A new estimate of the sender's clock is taken over at this share of the pace of time, so that no stamp leaps."""
STEP_S = 0.05
"""A difference above this is no better estimate but another clock: it is taken over at once."""
EVEN = 0.25
"""A step between samples is even if it is within this share of a period."""
STEADY_S = 1.0
"""After so long with even steps alone, a leap by whole periods is that many samples lost."""
OLDEST_S, NEWEST_S = 3600.0, 1.0
"""A stamp further before its arrival, or further after, is not of LSL's clock. One from the future holds up all that follow it."""
BACK_S, NEAR_S, SURE = 1.0, 10.0, 20
"""A stamp that runs back by more than the first is of a clock that was set. This many in a row that are impossible, or run back so, and lie
within the second of each other, are of another clock, which is followed from then on."""
NOTICED_NS = 1000
"""A stamp that runs back by less is a rounding error."""


@dataclass(frozen=True, slots=True)
class Mapped:
    """The samples of one read.

    time         (n,) session time, ns; later than all before it, and never decreasing
    gaps         (index, lost) where samples are missing before it; -1: unknown
    backwards    how many stamps lay before an earlier one, and were moved to it
    impossible   how many stamps could not be of LSL's clock; their arrival is taken
    back_s       how far the farthest of them was moved
    shifted_s    by how much stamps are moved from this read on, because they are of another clock; 0.0: no more than before
    """

    time: Times
    gaps: list[tuple[int, int]]
    backwards: int
    impossible: int
    shifted_s: float = 0.0
    back_s: float = 0.0


class LslStamps:
    """Maps one stream's stamps (s, on its sender's clock) to session time.

    Sample by sample, in plain Python: a read brings a few samples after a pause, when numpy's many small calls take ten times as long.
    """

    def __init__(self, rate_hz: float | None, zero_ns: int, gap_s: float = 0.5, latency_s: float = 0.0) -> None:
        """`zero_ns` is the session time of LSL's local clock at 0; `rate_hz` None: no leap is a loss."""
        self._zero, self._base = zero_ns, zero_ns - round(latency_s * NS)
        self._leaps = Leaps(rate_hz, gap_s) if rate_hz else None
        self._target = self._correction = 0.0
        self._raw: float | None = None
        self._last: int | None = None
        self._moved = 0.0
        """Added to stamps that are of another clock (s)."""
        self._good = -inf
        """The last stamp of the clock that is followed."""
        self._strange = 0
        self._strange_at = 0.0

    def correct(self, correction_s: float, *, at_once: bool = False) -> None:
        """A new estimate of what to add to the sender's stamps to have local ones (s); `at_once` after a pause."""
        self._target = correction_s
        if at_once or abs(correction_s - self._correction) > STEP_S:
            self._correction = correction_s

    def begin(self, raw: float, arrival_ns: int) -> float:
        """The newest sample of all, before any is mapped: by how much stamps are moved from the start, because this is of another clock."""
        arrival = (arrival_ns - self._zero) / NS - self._correction
        if isfinite(raw) and not arrival - OLDEST_S < raw < arrival + NEWEST_S:
            self._moved = arrival - raw
        return self._moved

    def map(self, stamps: Samples, arrival_ns: int, *, after_pause: bool = False) -> Mapped:
        """Session times of samples with these stamps (n,), n > 0, read at `arrival_ns`. `after_pause`: the connection was lost before."""
        raws: list[float] = stamps.tolist()
        if self._moved:
            raws = [raw + self._moved for raw in raws]
        arrival = (arrival_ns - self._zero) / NS - self._correction
        if not after_pause and self._is_even(raws, arrival):
            shift = self._shift
            times = [round(raw * NS) + shift for raw in raws]
            self._good = raws[-1]
            self._raw, self._last = raws[-1], times[-1]
            return Mapped(np.array(times, np.int64), [], 0, 0)
        return self._one_by_one(raws, arrival, self._pause(raws) if after_pause else -1)

    def _is_even(self, raws: list[float], arrival: float) -> bool:
        """Whether nothing has to be decided: possible stamps, no leap, no new estimate. As it nearly always is, this is the quick way."""
        leaps = self._leaps
        return (
            leaps is not None
            and self._last is not None
            and self._correction == self._target
            and arrival - OLDEST_S < raws[0] < arrival + NEWEST_S
            and raws[-1] < arrival + NEWEST_S
            and round(raws[0] * NS) + self._shift > self._last
            and leaps.absent(raws)
        )

    def _one_by_one(self, raws: list[float], arrival: float, pause: int) -> Mapped:
        """Every stamp looked at; `pause`: before which one the connection was lost, or -1."""
        oldest, newest = arrival - OLDEST_S, arrival + NEWEST_S
        leaps, shift = self._leaps, self._shift
        times: list[int] = []
        gaps: list[tuple[int, int]] = []
        backwards = impossible = 0
        floor = self._last + 1 if self._last is not None else None
        shifted = back_s = 0.0
        for i, raw in enumerate(raws):
            raw += shifted
            is_possible = oldest < raw < newest
            if is_possible and raw >= self._good - BACK_S:
                self._strange, self._good = 0, raw
            elif self._is_another_clock(raw) and isfinite(raws[-1]):
                more = arrival - shifted - raws[-1]
                raw, shifted, is_possible = raw + more, shifted + more, True
                self._good = raw
                gaps.append((i, -1))
            if not is_possible:
                raw, impossible = arrival, impossible + 1
            if self._correction != self._target:
                shift = self._slew(raw)
            lost = leaps.before(raw, pause=i == pause) if leaps else -(i == pause)
            if lost and (not gaps or gaps[-1][0] != i):
                gaps.append((i, lost))
            time = round(raw * NS) + shift
            if floor is not None and time < floor:
                backwards += floor - time > NOTICED_NS
                back_s = max(back_s, (floor - time) / NS)
                time = floor
            self._raw, floor = raw, time
            times.append(time)
        self._last = times[-1]
        self._moved += shifted
        return Mapped(np.array(times, np.int64), gaps, backwards, impossible, shifted, back_s)

    def _is_another_clock(self, raw: float) -> bool:
        """Whether this stamp, which does not follow the ones before, is the last of enough of them."""
        self._strange = self._strange + 1 if abs(raw - self._strange_at) < NEAR_S else 1
        self._strange_at = raw
        if self._strange < SURE:
            return False
        self._strange = 0
        return True

    @property
    def _shift(self) -> int:
        """What makes session time of a stamp in ns."""
        return self._base + round(self._correction * NS)

    def _slew(self, raw: float) -> int:
        """The shift at a stamp, a little nearer to the newest estimate."""
        rest = self._target - self._correction
        most = SLEW * max(0.0, raw - self._raw) if self._raw is not None else 0.0
        self._correction = self._target if abs(rest) <= most else self._correction + (most if rest > 0 else -most)
        return self._shift

    def _pause(self, raws: list[float]) -> int:
        """Before which sample the pause was: what had come before it may be in the same read."""
        if self._leaps is None or self._raw is None:
            return 0
        return int(np.argmax(np.diff(np.clip(np.nan_to_num(raws), -1e12, 1e12), prepend=self._raw)))


class Leaps:
    """Where the stamps of a regular stream leap. LSL counts nothing, so this is all that can be known of a loss.

    A sender that stamps evenly loses a number of samples that is known. One that stamps as it happens to get at its samples does not:
    its leaps are gaps only above `gap_s`, of unknown size.
    """

    def __init__(self, rate_hz: float, gap_s: float) -> None:
        self._period, self._gap = 1.0 / rate_hz, max(gap_s, 1.5 / rate_hz)
        self._least, self._most = (1 - EVEN) / rate_hz, (1 + EVEN) / rate_hz
        self._last: float | None = None
        self._even_since = 0.0

    def absent(self, stamps: list[float]) -> bool:
        """Whether all of these follow each other evenly; if so, they have been seen."""
        least, most, last = self._least, self._most, self._last
        if last is None:
            return False
        for stamp in stamps:
            if not least <= stamp - last <= most:
                return False
            last = stamp
        self._last = last
        return True

    def before(self, stamp: float, *, pause: bool = False) -> int:
        """How many samples are missing before the one with this stamp; -1: unknown."""
        last, self._last = self._last, stamp
        if last is None or pause:
            self._even_since = stamp
            return -pause
        if self._least <= stamp - last <= self._most:
            return 0
        return self._uneven(last, stamp)

    def _uneven(self, last: float, stamp: float) -> int:
        periods = (stamp - last) / self._period
        whole = round(periods)
        if whole > 1 and abs(periods - whole) <= EVEN and last - self._even_since >= STEADY_S:
            return whole - 1
        self._even_since = stamp
        return -1 if stamp - last > self._gap else 0
