"""The gate that every stream passes, live or imported: what was declared is compared with what arrives. No clock, no thread, no port.

`ClaimGate.see` looks at each chunk in one kernel, which also decides whether its stamps are in order; it changes nothing. What is found is
a pure function of the samples, however they are cut into chunks. `look` gives each `Finding` once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec, Times
from kinegraph.stream.compiler.record import numbers_of
from kinegraph.stream.domain.finding import Finding, wrong_rate
from kinegraph.stream.domain.rotation import rotations
from kinegraph.stream.kernel import kernel

END = 2**62
"""Stamps of samples are before this time (the year 2116) and after its negative."""
WRONG = 0.03
"""By this share a rate may be off: filters bear it, and clocks follow it."""
WRONG_BY_STAMPS = 0.01
"""The same where a sender stamps its samples by a clock: by more no clock is off."""
WINDOW_NS, WINDOW_SAMPLES, WINDOWS = 8 * NS, 50, 6
"""A rate is judged after this time and number of samples; where jitter leaves it open, after up to `WINDOWS` of them."""
LEAP_NS, LEAP_PERIODS = 2 * NS, 10
"""A longer step, in both measures, is a leap."""
STANDS_NS, STANDS_SAMPLES = NS, 20
"""This number of samples with one stamp, that should take this long, are a clock that stands still."""
REPEATED, ENOUGH = 0.2, 100
"""The share of samples of a window with the stamp of the one before that is a finding, and of how many."""
ROWS, ROW_NS = 32, NS // 4
"""Samples by which units are judged, and how far they are apart."""


class _Numbers:
    """What was declared, and what has been seen.

    period      nominal, ns; 0: irregular
    wrong       by which share the rate may be off
    leap, window, stands   in ns, ns and samples
    row_ns      how far apart samples are kept for the units; 0: not at all
    last        the last stamp; `begin` and `count`: where the present window began, and how many samples came after it, lost ones included
    widest      the longest step in this window, ns; `same` how many of 0; `run` how many of 0 in a row
    measured    the rate found instead of the declared one; 0: the declared one holds
    rate_since, repeat_since, stands_since, leap_since   stamps; 0: not found
    leap_ns     how far the first leap went
    """

    period: float
    wrong: float
    leap: int
    window: int
    stands: int
    row_ns: int
    begun: bool
    last: int
    begin: int
    count: int
    widest: int
    same: int
    run: int
    row_due: int
    measured: float
    rate_since: int
    repeat_since: int
    stands_since: int
    leap_since: int
    leap_ns: int


NUMBERS = numbers_of(_Numbers)


@kernel
def survey(time: Times, until: int, lost: int, numbers: Array) -> int:
    """0: stamps (n,) of a chunk are out of order, or past `until`, and nothing was noted. 1: they are fine; 2: and its first sample is due
    for the units."""
    before = 1 - END
    for i in range(time.shape[0]):
        if time[i] < before:
            return 0
        before = time[i]
    if before > until:
        return 0
    seen = numbers[0]
    n = time.shape[0]
    if lost < 0:
        seen.begun = False
    elif lost > 0:
        seen.count += lost
    if n == 0:
        return 1
    due = seen.row_ns > 0 and time[0] >= seen.row_due
    if due:
        seen.row_due = time[0] + seen.row_ns
    if seen.period > 0.0:
        for i in range(n):
            stamp = time[i]
            step = stamp - seen.last
            seen.last = stamp
            is_leap = seen.begun and step > seen.leap and not (i == 0 and lost > 0)
            if is_leap and seen.leap_since == 0:
                seen.leap_since, seen.leap_ns = stamp, step
            if is_leap or not seen.begun:
                seen.begun = True
                seen.begin = stamp
                seen.count = seen.widest = seen.same = seen.run = 0
                continue
            seen.count += 1
            if not (i == 0 and lost > 0):
                seen.widest = max(seen.widest, step)
            if step == 0:
                seen.same += 1
                seen.run += 1
                if seen.run >= seen.stands and seen.stands_since == 0:
                    seen.stands_since = stamp
            else:
                seen.run = 0
            span = stamp - seen.begin
            if span >= seen.window:
                ratio = seen.count * seen.period / span
                off = abs(ratio - 1.0)
                is_wrong = off > seen.wrong + 2.0 * seen.widest / span
                if is_wrong and seen.rate_since == 0:
                    seen.rate_since = seen.begin
                    seen.measured = seen.count * 1e9 / span
                if seen.same >= REPEATED * seen.count and seen.count >= ENOUGH and seen.repeat_since == 0:
                    seen.repeat_since = seen.begin
                if is_wrong or off < 0.5 * seen.wrong or span >= WINDOWS * seen.window:
                    seen.begin = stamp
                    seen.count = seen.widest = seen.same = 0
    return 2 if due else 1


class ClaimGate:
    """One stream's. `see` every chunk of it; `look` now and then, and at the end.

    found    all findings so far
    numbers  (1,) what `survey` notes
    """

    __slots__ = ("_ahead", "_backwards", "_remedy", "_rows", "found", "numbers", "spec", "stream")

    def __init__(self, stream: str, spec: StreamSpec, *, wrong: float = WRONG, remedy: str = "") -> None:
        """`wrong`: the share by which a rate may be off; `remedy`: what to do about a wrong rate."""
        self.stream, self.spec, self.found = stream, spec, list[Finding]()
        self._remedy, self._backwards, self._ahead = remedy, (0, 0), (0, 0)
        self._rows: list[Array] = []
        self.numbers = numbers = np.zeros(1, NUMBERS)
        if spec.rate_hz and not spec.is_event:
            period = NS / spec.rate_hz
            numbers["period"], numbers["wrong"] = period, wrong
            numbers["leap"] = min(max(LEAP_NS, round(LEAP_PERIODS * period)), END)
            numbers["window"] = min(max(WINDOW_NS, round(WINDOW_SAMPLES * period)), END)
            numbers["stands"] = max(STANDS_SAMPLES, round(STANDS_NS / period))
        numbers["row_ns"] = ROW_NS if _has_judged_unit(spec) else 0
        numbers["row_due"] = -END

    def see(self, chunk: Chunk) -> bool:
        """Whether stamps are in order; what there is to note is noted. The chunk's arrays must be of the declared types."""
        code = survey(chunk.time, chunk.until, chunk.lost, self.numbers)
        if code > 1:
            self.keep(chunk.data[0])
        return code > 0

    def keep(self, sample: Array) -> None:
        """A sample by which the unit is judged."""
        self._rows.append(np.array(sample, np.float64))
        if len(self._rows) >= ROWS:
            self.numbers["row_ns"] = 0

    def ran_backwards(self, samples: int, stamp: int) -> None:
        """`samples` were out of order and left out, the first at `stamp`."""
        self._backwards = self._backwards[0] + samples, self._backwards[1] or stamp

    def is_ahead(self, ahead_ns: int, stamp: int) -> None:
        """A stamp of the session's clock is so far ahead of it."""
        self._ahead = self._ahead if self._ahead[0] else (ahead_ns, stamp)

    def look(self, *, over: bool = False) -> list[Finding]:
        """What is new. `over`: nothing will come any more."""
        known = {finding.kind for finding in self.found}
        new = [finding for finding in self._all(over) if finding.kind not in known]
        self.found += new
        return new

    @property
    def measured_hz(self) -> float:
        """The rate found instead of the declared one; 0.0: the declared one holds."""
        return float(self.numbers["measured"][0])

    def _all(self, over: bool) -> Iterator[Finding]:
        numbers, rate = self.numbers[0], self.spec.rate_hz or 0.0
        if numbers["rate_since"]:
            hz = float(numbers["measured"])
            remedy = self._remedy or f"declare {hz:.5g} Hz, or set the sender to {rate:g} Hz"
            yield wrong_rate(self.stream, rate, hz, remedy, int(numbers["rate_since"]))
        if self._backwards[0]:
            yield Finding(
                "order", self.stream, "samples in the order of time", f"{self._backwards[0]} samples stamped before an earlier one",
                "they are left out", "look at the sender's clock; files can be sorted by time", self._backwards[1],
            )  # fmt: skip
        if self._ahead[0]:
            yield Finding(
                "epoch", self.stream, "stamps of the session's clock", f"stamps {self._ahead[0] / NS:.1f} s ahead of it",
                "other streams wait for them", "Feed.now() and devices.clocks give stamps of the session's clock", self._ahead[1],
            )  # fmt: skip
        if numbers["leap_since"]:
            far = numbers["leap_ns"] / NS
            yield Finding(
                "leap", self.stream, "samples without a gap", f"a leap of {far:.3g} s",
                "filters and windows go across it as if nothing were missing", "mark what is missing by a counter, or cut there",
                int(numbers["leap_since"]),
            )  # fmt: skip
        if numbers["stands_since"]:
            yield Finding(
                "standstill", self.stream, f"{rate:g} Hz", "many samples with one stamp", "their times are not known",
                "look at the sender's clock, or leave its time out", int(numbers["stands_since"]),
            )  # fmt: skip
        elif numbers["repeat_since"]:
            yield Finding(
                "repeat", self.stream, f"{rate:g} Hz", "samples with the stamp of the one before",
                "samples may be there twice, or the clock is coarse", "leave out what is repeated, or give a counter",
                int(numbers["repeat_since"]),
            )  # fmt: skip
        if self._rows and (over or not numbers["row_ns"]):
            yield from unit_findings(self.stream, self.spec, np.array(self._rows))


def check_series(gate: ClaimGate, time: Times, data: Array, lost: Array | None) -> list[Finding]:
    """A whole stream through a gate. One that is shorter than a window is judged all the same, if it has samples enough."""
    numbers = gate.numbers
    if len(time) > WINDOW_SAMPLES:
        numbers["window"] = np.minimum(numbers["window"], max(1, int(time[-1] - time[0])))
    cuts = [0] if lost is None else [0, *(np.flatnonzero(lost[1:]) + 1).tolist()]
    for start, stop in zip(cuts, [*cuts[1:], len(time)], strict=True):
        part = Chunk(time[start:stop], data[start:stop], END, 0 if lost is None or not len(lost) else int(lost[start]))
        gate.see(part)
    if gate.numbers["row_ns"][0]:
        stride = max(1, len(data) // ROWS)
        for sample in data[::stride][:ROWS]:
            gate.keep(sample)
    return gate.look(over=True)


# units -------------------------------------------------------------------------------------------------------------

ACCELERATIONS = {"g": 1.0, "m/s2": 9.81, "m/s^2": 9.81, "m/s²": 9.81}
VOLTS = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
NOISE_V, MOST_V = 2e-9, 500.0
"""No amplifier's noise is below the first, no electrode gives more than the second."""
TURNS = {"deg/s": 1.0, "rad/s": 57.29577951308232}
NOISE_DEG_S, MOST_DEG_S = 0.002, 4000.0
"""The noise of gyroscopes that people wear is some hundredths of a degree per second; their widest range is the second."""
WARMTHS = {"degC": 0.0, "°C": 0.0, "C": 0.0, "K": -273.15}
COLD_C, HOT_C = -40.0, 85.0
"""The range for which electronics are made; on skin and in rooms it is less."""
RANGE = 4.0
"""How many standard deviations some tens of samples range over."""
STILL, SAMPLES = 0.1, 8
"""A length of acceleration within this share of one value, over most of the time, is gravity. At least this number of samples is judged."""
UNIT_LENGTH = 0.05


def _has_judged_unit(spec: StreamSpec) -> bool:
    if spec.is_event or spec.dtype.kind not in "fiu" or not spec.shape:
        return False
    return bool(rotations(spec)) or bool(_groups(spec))


def _groups(spec: StreamSpec) -> list[tuple[str, slice]]:
    """Neighbouring channels of one unit that is judged, sensors of three axes in threes."""
    if len(spec.shape) != 1 or len(spec.units) not in (1, spec.shape[0]):
        return []
    units, found, start = spec.units * (spec.shape[0] if len(spec.units) == 1 else 1), list[tuple[str, slice]](), 0
    while start < len(units):
        unit, stop = units[start], start
        while stop < len(units) and units[stop] == unit:
            stop += 1
        if unit in VOLTS or unit in WARMTHS:
            found.append((unit, slice(start, stop)))
        elif (unit in ACCELERATIONS or unit in TURNS) and (stop - start) % 3 == 0:
            found += [(unit, slice(at, at + 3)) for at in range(start, stop, 3)]
        start = stop
    return found


def unit_findings(stream: str, spec: StreamSpec, rows: Array) -> Iterable[Finding]:
    """What cannot be in samples (k, *shape), k spread over the stream."""
    if len(rows) < SAMPLES:
        return
    for at in rotations(spec):
        length = np.linalg.norm(rows[..., at : at + 4], axis=-1)
        length = length[np.isfinite(length) & (length > 0)]
        if len(length) and abs(float(np.median(length)) - 1.0) > UNIT_LENGTH:
            yield Finding(
                "rotation", stream, "unit quaternions", f"a length of {float(np.median(length)):.3g}",
                "rotations would be wrong", "look at the channels and their scale",
            )  # fmt: skip
            return
    for unit, part in _groups(spec):
        found = list(_judged(stream, unit, rows[:, part]))
        if found:
            yield from found
            return


def _judged(stream: str, unit: str, rows: Array) -> Iterable[Finding]:
    if unit in ACCELERATIONS:
        return _gravity(stream, unit, np.linalg.norm(rows, axis=1))
    if unit in TURNS:
        return _turning(stream, unit, rows)
    return _voltage(stream, unit, rows) if unit in VOLTS else _warmth(stream, unit, rows)


def _gravity(stream: str, unit: str, length: Array) -> Iterable[Finding]:
    """Of a sensor that mostly rests the length of its acceleration is gravity's, in one unit or another."""
    length = length[np.isfinite(length)]
    if len(length) < SAMPLES:
        return
    low, middle, high = np.percentile(length, [25, 50, 75])
    if middle <= 0 or high - low > STILL * middle:
        return
    here = ACCELERATIONS[unit]
    for name, gravity in (("g", 1.0), ("m/s2", 9.81), ("mg", 1000.0)):
        if abs(middle / gravity - 1.0) < STILL and abs(gravity / here - 1.0) > STILL:
            yield Finding(
                "unit", stream, unit, f"a length of {middle:.4g} at rest, which is gravity in {name}",
                f"accelerations are off by a factor of {max(gravity / here, here / gravity):.3g}",
                f"declare the unit {name}, or scale them",
            )  # fmt: skip


def _turning(stream: str, unit: str, rows: Array) -> Iterable[Finding]:
    """Faster than any gyroscope measures most of the time are counts or another unit; so is a sensor without noise."""
    rows = rows[np.isfinite(rows).all(axis=1)] * TURNS[unit]
    if len(rows) < SAMPLES:
        return
    fast, spread = float(np.percentile(np.linalg.norm(rows, axis=1), 75)), np.ptp(rows, axis=0) / RANGE
    spread = spread[spread > 0]
    if fast > MOST_DEG_S:
        seen = f"mostly above {fast / TURNS[unit]:.3g} {unit}, more than any gyroscope measures"
    elif len(spread) and spread.max() < NOISE_DEG_S:
        seen = f"values that spread by {spread.max() / TURNS[unit]:.3g} {unit}, less than a gyroscope's noise"
    else:
        return
    yield Finding(
        "unit", stream, unit, seen, "angles would be off by the same factor",
        "declare the right unit (deg/s is 57.3 times rad/s), or scale them",
    )  # fmt: skip


def _warmth(stream: str, unit: str, rows: Array) -> Iterable[Finding]:
    """What is far from all that electronics bear is another unit, or counts."""
    finite = rows[np.isfinite(rows)] + WARMTHS[unit]
    if len(finite) < SAMPLES or COLD_C <= (middle := float(np.median(finite))) <= HOT_C:
        return
    other = "K" if COLD_C <= middle - 273.15 <= HOT_C else "degC" if COLD_C <= middle + 273.15 <= HOT_C else ""
    yield Finding(
        "unit", stream, unit, f"about {middle - WARMTHS[unit]:.4g} {unit}" + (f", which may be {other}" if other else ""),
        "no sensor on a body is so cold or hot", f"declare the unit {other}" if other else "declare the right unit, or scale them",
    )  # fmt: skip


def _voltage(stream: str, unit: str, rows: Array) -> Iterable[Finding]:
    """About each channel's standard deviation: below noise, or above all electrodes, in every channel that is not constant."""
    with np.errstate(all="ignore"):
        finite = np.where(np.isfinite(rows), rows, np.nan)[:, np.isfinite(rows).any(axis=0)]
        spread = (np.nanmax(finite, axis=0) - np.nanmin(finite, axis=0)) / RANGE * VOLTS[unit]
    spread = spread[spread > 0]
    if not len(spread) or not (spread.max() < NOISE_V or spread.min() > MOST_V):
        return
    what = "less than any amplifier's noise" if spread.max() < NOISE_V else "more than any electrode gives"
    seen = float(np.median(spread)) / VOLTS[unit]
    yield Finding(
        "unit", stream, unit, f"values that spread by {seen:.3g} {unit}, {what}", "amplitudes are off by a power of ten",
        "declare the right unit, or scale them",
    )  # fmt: skip
