"""Whether a device is as it was declared: its rate, and the unit of its time, held against the session's clock in its first seconds."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.clocks.device_time import STILL_NS, STILL_STEPS
from kinegraph.devices.clocks.mismatch_text import of_rate, of_turn, of_unit
from kinegraph.stream.chunk import NS, Samples, Times
from kinegraph.stream.domain.finding import REPORT, Finding, wrong_rate
from kinegraph.stream.errors import DeclarationError
from kinegraph.stream.source import Feed

Policy = Literal["fail", "warn"]
POLICY_HELP = (
    "a device that is not as declared ends the session at its start (later: raises the alarm), or only raises the alarm"
)

WRONG = 0.03
"""By this much a rate may be off: filters bear it, and the clocks follow it."""
FROM_S, TO_S = 2.0, 10.0
SURE_S = 1.0
"""Before `TO_S`, what is not as declared differs by this much; less may be a radio's queue that fills or empties at the start."""
LOSS = 0.15
"""This many samples too few, and no counter that tells why: lost ones, perhaps, which are no reason to end a session."""
STANDS = "its time stands still: every record has the same one; is it the column or field of the time? Else leave the time out"
LOOK_NS = NS // 2
PAUSE_NS = 50 * NS
"""Between the ten seconds in which a device is looked at, and the next."""
BUCKET_NS = NS // 4
OUTLIER = 50
"""A step of the device's time this many times as long as usual is an outage or a jump, and says nothing of its pace."""
TWICE = 0.1
"""If fewer steps of the device's time are 0, these are repeated records, not a coarse time."""
TOLD_AGAIN = 0.01
BEHIND = 0.75
"""A time that fits the declared rate may run so slow: a computer that does not keep up takes late what came in time."""
STILL = 10
"""This many records with one and the same time, over `FROM_S` or more: the device's time stands still."""
TURNS, SHORTEST_NS = 4, NS // 2
"""How often its time goes back in the first seconds, each time from about the same value to about 0: it starts again at that value. A value
that is higher than that may be a device that is switched off and on."""


class RateCheck:
    """One stream's. `see` gathers what comes; what is found ends the session or raises the alarm, as `policy` has it."""

    def __init__(
        self, device: str, rate_hz: float | None, policy: Policy, *, setting: str = "rate_hz", unit: str = "", counted: bool = False,
        wraps_ns: int = 0, wrong: float = WRONG, has_clock: bool = True,
    ) -> None:  # fmt: skip
        """`setting`: the parameter that holds the rate, or a sentence; `unit`: of the device's time, as declared by `time_unit`;
        `counted`: what is lost is known by a counter; `wraps_ns`: where the device's time starts again, as declared;
        `wrong`: by which share a rate by the device's time may be off; `has_clock`: whether a session needs the device's time, so that a
        wrong one ends it in any case."""
        self._wrong, self._has_clock = wrong, has_clock
        self._device, self._rate, self._policy = device, rate_hz, policy
        self._setting, self._unit, self._counted = setting, unit, counted
        self._wraps = wraps_ns if wraps_ns < 2**62 else 0
        self._told = rate_hz or 0.0
        self._first = True
        self._stood = False
        """Whether the stopped clock has been reported."""
        self._from = 0
        self._begin()

    def _begin(self) -> None:
        self._arrivals: list[int] = []
        self._came: list[int] = []
        self._made: list[int] = []
        """With those that are missing by the counter; it may have been garbled, so that the truth lies between the two."""
        self._steps: list[Times] = []
        self._last: int | None = None
        self._zero = 0
        """The device's time of the first record."""
        self._due = 0

    def see(self, n: int, lost: int, arrival_ns: int, feed: Feed, device_ns: Times | None = None) -> float | None:
        """`n` > 0 records have come now, before and between which `lost` are missing; with them the device's own times (n,), not unwrapped.

        Returns the true rate where it has been found to be another one. Raises DeclarationError.
        """
        if arrival_ns < self._from or not (self._rate or device_ns is not None):
            return None
        if device_ns is not None:
            if self._last is None:
                self._zero = self._last = int(device_ns[0])
            steps: Times = np.diff(device_ns, prepend=self._last) if len(device_ns) > 1 else device_ns - self._last
            if self._wraps:
                # a step back by nearly the whole range is a wrap; a small step back is one, and stays so
                steps = np.where(steps % self._wraps < self._wraps // 2, steps % self._wraps, steps)
            self._steps.append(steps)
            self._last = int(device_ns[-1])
        self._made.append((self._made[-1] + n + lost) if self._made else 0)
        self._came.append((self._came[-1] + n) if self._came else 0)
        self._arrivals.append(arrival_ns)
        self._due = self._due or arrival_ns + round(FROM_S * NS)
        if arrival_ns < self._due:
            return None
        # the look sorts all pairs of points: not with every packet
        self._due = arrival_ns + LOOK_NS
        return self._look(arrival_ns, feed)

    def _look(self, arrival_ns: int, feed: Feed) -> float | None:
        passed = arrival_ns - self._arrivals[0]
        stood_ns, longest_ns = self._stands(arrival_ns)
        if stood_ns:
            if stood_ns > longest_ns:
                self._report_standstill((passed - stood_ns) / NS, feed)
                self._begin()
            return None
        self._stood = False
        over, first = passed >= TO_S * NS, self._first
        # early, an error must be large to be sure: a late first packet alone makes some per cent
        least = WRONG if over else max(WRONG, SURE_S * NS / passed)
        found, text = None, ""
        if first or over:
            if self._steps:
                found, text = self._by_time(least)
            else:
                found, text = self._by_count(least)
        grave = first and not feed.again and (found is None or not self._may_be_loss(found))
        if over or found is not None:
            self._begin()
            self._first, self._from = False, arrival_ns + PAUSE_NS
        if found is None:
            return None
        return self._report(found, text, grave, feed)

    def _stands(self, arrival_ns: int) -> tuple[int, int]:
        """For how long (ns) records have come with one time, after others (0: they do not); and for how long a time may stand."""
        moved = next((i for i in range(len(self._steps) - 1, -1, -1) if self._steps[i].any()), None)
        if moved is None or self._made[-1] - self._made[moved] < STILL:
            return (arrival_ns - self._arrivals[0], 0) if self._stood and moved is None and self._steps else (0, 0)
        last, stood = self._steps[moved], arrival_ns - self._arrivals[moved]
        usual = int(last[last != 0][-1])
        return (stood, max(STILL_NS, STILL_STEPS * usual)) if stood > 2 * usual else (0, 0)

    def _report_standstill(self, after_s: float, feed: Feed) -> None:
        """Its stamps are the arrivals' from here on; at the start that is no way to begin. Raises DeclarationError."""
        text = f"its time stands still at {self._last} ns from {after_s:.1f} s on: has the device's clock stopped?"
        if self._first and self._policy == "fail" and not feed.again:
            raise DeclarationError(
                f"{self._device} is not as declared: {text}; `rate_mismatch: warn` goes on by the arrivals"
            )
        self._first = False
        if not self._stood:
            self._stood = True
            feed.problem("time stands still")
            self._find("clock", text, feed)

    def _find(self, kind: str, seen: str, feed: Feed, hz: float = 0.0) -> None:
        """Whatever was found, with what is to be set, is in `seen`, in words."""
        if hz and self._rate:
            made = wrong_rate(self._device, self._rate, hz, seen)
        else:
            consequence = "stamps follow the arrivals, which jitter"
            made = Finding(
                kind, self._device, "", seen, consequence, "set what the device sends, or leave its time out"
            )
        feed.tell(REPORT, **made.facts())

    def _may_be_loss(self, hz: float) -> bool:
        """Whether a rate is one that the declared one becomes where samples are lost on the way, unseen."""
        return not self._counted and not self._steps and self._rate is not None and 1 - LOSS < hz / self._rate < 1

    def _by_count(self, least: float) -> tuple[float | None, str]:
        """The true rate, if it is another one, and what to say of it."""
        assert self._rate
        arrivals, period = np.array(self._arrivals), NS / self._rate
        share = _pace(arrivals, np.array(self._made) * period, least)
        if share is not None and share > 1 and self._came != self._made:
            share = share if (_pace(arrivals, np.array(self._came) * period, least) or 0) > 1 else None
        if share is None:
            return None, ""
        hint = "" if self._counted else ", or samples are lost on the way (a counter would tell)"
        return self._rate * share, of_rate(self._rate * share, self._rate, self._setting) + hint

    def _by_time(self, least: float) -> tuple[float | None, str]:
        steps = np.concatenate(self._steps).astype(np.float64)[1:]
        good = steps[steps > 0]
        if len(good) < 2:
            return (0.0, STANDS) if not steps.any() and len(steps) >= STILL else (None, "")
        if self._first and (turn := self._turn(steps)):
            return 0.0, of_turn(turn, self._unit)
        usual = _usual(steps[steps >= 0])
        self._bridge(steps, (steps < 0) | (steps > OUTLIER * max(usual, float(np.median(good)))), usual)
        ends = np.cumsum([len(part) for part in self._steps]) - 1
        device = np.concatenate([[0.0], np.cumsum(steps)])[ends]
        pace = _pace(np.array(self._arrivals), device, least)
        if pace is not None and not (pace < 1 and self._fits(usual) and (pace > BEHIND or least > WRONG)):
            return 0.0, of_unit(pace, self._unit)
        if not self._rate:
            return None, ""
        overall = self._made[-1] / device[-1] * NS
        coarse = float(np.median(good)) if np.count_nonzero(steps == 0) > TWICE * len(steps) else 0.0
        rates = [NS / usual, overall] if self._counted else [overall, NS / usual]
        if self._came[-1] / device[-1] * NS < self._rate < overall or any(
            abs(hz / self._rate - 1) <= self._wrong + 2 * coarse / device[-1] for hz in rates
        ):
            return None, ""
        return rates[-1], of_rate(rates[-1], self._rate, self._setting)

    def _turn(self, steps: Samples) -> float:
        """The value (ns) at which the device's time starts again and again, by its `steps` (n,); 0.0: it does not."""
        raw = self._zero + np.concatenate([[0.0], np.cumsum(steps)])
        back = np.flatnonzero(steps < 0)
        if len(back) < TURNS:
            return 0.0
        top, near = float(np.median(raw[back])), 3 * float(np.median(steps[steps > 0]))
        alike = (np.abs(raw[back] - top) <= max(near, 0.05 * top)) & (np.abs(raw[back + 1]) <= max(near, 0.05 * top))
        return top + near / 3 if alike.mean() > 0.8 and near < top < SHORTEST_NS else 0.0

    def _bridge(self, steps: Samples, jumps: NDArray[np.bool_], usual: float) -> None:
        """Where the device's time jumps (n,), as much is put in as went by at its packet's arrival, and at least a usual step."""
        if not jumps.any():
            return
        packet = np.repeat(np.arange(len(self._steps)), [len(part) for part in self._steps])[1:]
        passed = np.diff(self._arrivals, prepend=self._arrivals[0]) - np.bincount(
            packet[~jumps], steps[~jumps], len(self._steps)
        )
        share = passed[packet[jumps]] / np.bincount(packet[jumps], minlength=len(self._steps))[packet[jumps]]
        steps[jumps] = np.maximum(share, usual)

    def _fits(self, usual: float) -> bool:
        """Whether the steps of the device's time are those of the declared rate: then its unit is right, too."""
        return self._rate is not None and abs(NS / usual / self._rate - 1) <= WRONG

    def _report(self, hz: float, text: str, at_start: bool, feed: Feed) -> float | None:
        if at_start and (self._policy == "fail" or (not hz and self._has_clock)):
            more = "; `rate_mismatch: warn` goes on by the true rate" if hz else ""
            raise DeclarationError(f"{self._device} is not as declared: {text}{more}")
        feed.problem("rate mismatch")
        if not hz or abs(hz / self._told - 1) > TOLD_AGAIN:
            self._find("rate" if hz else "clock", text, feed, hz)
        self._told = hz or self._told
        return hz or None


def _usual(steps: Samples) -> float:
    """The mean step between records that follow each other (n,): with a coarse time some are a unit longer, or 0."""
    if np.count_nonzero(steps == 0) < TWICE * len(steps):
        steps = steps[steps > 0]
    smallest = float(steps[steps > 0].min())
    return float(steps[steps <= 1.75 * max(float(np.median(steps)), smallest)].mean())


def _pace(arrival: Times, made: Samples, least: float) -> float | None:
    """How much faster than time `made` (n,) ns runs that has come at `arrival` (n,) ns, if that is off by more than `least`; else None.

    By the packets that were least late in each quarter of a second, and only if it is so in both halves of the time.
    """
    since, made = (arrival - arrival[0]).astype(np.float64), made - made[0]
    if made[-1] <= 0 or since[-1] <= 0:
        return None
    late = since - made * (since[-1] / made[-1])
    # the least late packet of each bucket: the others were held up on the way, and only add noise
    order = np.lexsort((late, since // BUCKET_NS))
    firsts = np.unique(since[order] // BUCKET_NS, return_index=True)[1]
    points = np.sort(order[firsts])
    x, y = since[points], made[points]
    # one pause of the sender bends the whole, but not both halves
    half = len(x) // 2
    if half < 3:
        return None
    paces = [_slope(x[part], y[part]) for part in (slice(None), slice(half), slice(half, None))]
    whole, *halves = paces
    if abs(whole - 1) <= least or any((p - 1) * np.sign(whole - 1) < least / 2 for p in halves):
        return None
    return whole


def _slope(x: Samples, y: Samples) -> float:
    """The median of the slopes of all pairs of points (Theil 1950, Sen 1968)."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
