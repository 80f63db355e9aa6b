"""When a file's samples were taken: a time column, a rate, or a packet counter, made into stamps and numbers of lost samples."""

from __future__ import annotations

import re

import numpy as np

from kinegraph.stream.chunk import NS, Array, Times
from kinegraph.stream.errors import RecordingError

UNITS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": NS, "min": 60 * NS}
SPELT = {"sec": "s", "second": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms", "usec": "us"}
"""Units of time as other programs write them into a table's header."""
TOLERANCE = 0.3
"""How far a stamp may be from the regular grid, in periods, for the grid's own stamps to be put in its place."""
MAX_NS = 1 << 62
"""Times farther from 1970 than this (146 years) are refused: they cannot be real, and further on int64 overflows."""
MAX_HZ = 1e9
"""No stamp is finer than a nanosecond."""
UNEVEN = 0.25
"""Where the usual step is so far from the declared period, in periods, the rate is another one."""
SNAP = 1e-4
"""A measured rate within this share of a whole number (or of a tenth) is that number."""


def plain_unit(unit: str) -> str:
    """A unit with `u` for a micro sign, of either kind: as graphs and references spell it."""
    return f"u{unit[1:]}" if unit.startswith(("\u00b5", "\u03bc")) else unit


def unit_in(name: str, unit: str = "") -> str:
    """The unit of a column or array of times: as given in brackets (be it one of time or not), or by the name's ending, else seconds.

    Endings are those of `t_ms` and `t_ms:0`.
    """
    if unit:
        unit = plain_unit(unit)
        return SPELT.get(unit.lower().rstrip("."), unit)
    ending = re.search(r"_([a-z]+)(:\d+)?$", name)
    return ending[1] if ending and ending[1] in UNITS else "s"


def to_ns(values: Array, unit: str) -> Times:
    """Times in `unit` as int64 ns, exactly where the values are whole numbers. Raises ValueError for NaN, infinity, and other centuries."""
    if values.dtype.kind not in "iuf":
        raise ValueError("row 0 holds no time")
    wrong = ~(np.abs(values.astype(np.float64)) <= MAX_NS / UNITS[unit])
    if wrong.any():
        raise ValueError(f"row {int(np.flatnonzero(wrong)[0])} holds no time")
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * UNITS[unit]
    return np.round(values.astype(np.float64) * UNITS[unit]).astype(np.int64)


def grid_of(rate_hz: float, index: Array, anchor: int) -> Times:
    """Stamps of samples number `index` of a regular stream with sample 0 at `anchor` ns."""
    return anchor + np.round(index * (NS / rate_hz)).astype(np.int64)


def check_order(time: Times, what: str, row: int, *, repeated: bool) -> None:
    """Raises RecordingError at the first time that is not after the one before it (with `repeated`: that is before it).

    `row` is what the first time's row or line is called.
    """
    wrong = np.flatnonzero(np.diff(time) < 0 if repeated else np.diff(time) <= 0)
    if not len(wrong):
        return
    i = int(wrong[0])
    if time[i + 1] < time[i]:
        raise RecordingError(
            f"{what} {row + i + 1}: time runs backwards, from {time[i] / NS:.9g} s to {time[i + 1] / NS:.9g} s"
        )
    raise RecordingError(
        f"{what} {row + i + 1}: the time {time[i] / NS:.9g} s is repeated; if the clock is coarser than the rate, say --repeated"
    )


def regular(time: Times, rate_hz: float | None) -> tuple[float, Times, Array] | None:
    """Whether samples at `time` are regular, but for missing ones: the rate, exact stamps, and the samples lost before each.

    The rate is the given one, or is estimated from the times (a rate within 0.01 % of a whole number is taken for that number).
    Stamps come from an index and one anchor. None where the times lie more than 0.3 periods off every such grid.
    """
    if len(time) < 3:
        return None
    if rate_hz is not None:
        return _on_grid(time, rate_hz)
    measured = _estimate(time)
    if measured is None:
        return None
    meant = snapped(measured)
    rates = (measured, meant) if _distinguishes(time, measured, meant) else (meant, measured)
    return next((found for rate in rates if (found := _on_grid(time, rate))), None)


def resolution(time: Times) -> int:
    """The decimal place to which stamps were written, in ns, from 1 ms down to 1 us; 1 for finer ones."""
    return next((step for step in (10**6, 10**5, 10**4, 10**3) if not (time % step).any()), 1)


def _distinguishes(time: Times, measured: float, meant: float) -> bool:
    """Whether stamps with few decimals are too exact, over their whole length, to be those of the rate that was meant."""
    step = resolution(time)
    off = len(time) * abs(meant - measured) / measured
    return step > 1 and off > 0.05 + 2 * step * measured / NS


def _on_grid(time: Times, rate: float) -> tuple[float, Times, Array] | None:
    """As `regular`, for one rate."""
    period = NS / rate
    index = np.round((time - time[0]) / period).astype(np.int64)
    anchor = round(float(np.median((time - time[0]) - index * period)))
    stamps = grid_of(rate, index, int(time[0]) + anchor)
    if (np.diff(index) < 1).any() or np.abs(stamps - time).max() > TOLERANCE * period:
        return None
    lost = np.concatenate([[0], np.diff(index) - 1])
    return rate, stamps, lost


def _estimate(time: Times) -> float | None:
    """The measured rate from the median distance, made finer by the mean of all distances like it."""
    steps = np.diff(time)
    middle = float(np.median(steps))
    if middle <= 0:
        return None
    near = steps[np.abs(steps - middle) <= TOLERANCE * middle]
    count = len(near)
    return NS / float(near.mean()) if count else NS / middle


def snapped(rate: float) -> float:
    """A measured rate, or the whole number (or tenth) that it must have been meant to be."""
    for digits in (0, 1):
        near = round(rate, digits)
        if near > 0 and abs(rate - near) <= SNAP * rate:
            return near
    return rate


def lost_by_stamps(time: Times, rate: float) -> Array | None:
    """Samples missing where a regular stream's times leap by more than one and a half periods; None: no sample is, or they do not come at
    this rate at all."""
    steps = np.diff(time)
    if not len(steps) or abs(float(np.median(steps)) * rate / NS - 1.0) > UNEVEN:
        return None
    missing = np.round(steps * (rate / NS)).astype(np.int64) - 1
    return np.concatenate([[0], np.maximum(missing, 0)]) if (missing > 0).any() else None


def lost_by_counter(counter: Array, what: str, *, repeated: bool = False) -> tuple[Array, Array, str]:
    """Samples missing before each one by a packet counter that grows by one and may wrap at a power of two.

    A packet that appears again is left out: returns the rows that stay (m,), what was lost before each of them (m,) int64, and what is
    doubtful about it, in words. Raises RecordingError where the counter runs backwards, or repeats more often than in 1 % of the rows
    (`repeated`: than in all).
    """
    if counter.dtype.kind not in "iuf" or not (np.abs(counter.astype(np.float64)) < MAX_NS).all():
        raise RecordingError(f"{what} 0: the counter holds something else than whole numbers")
    values = counter.astype(np.int64)
    again = np.flatnonzero(np.diff(values) == 0) + 1
    if len(again) and (len(again) == len(values) - 1 or (len(again) > max(1, len(values) // 100) and not repeated)):
        raise RecordingError(
            f"{what} {again[0]}: the counter stands still at {values[again[0]]}, as in {len(again)} of {len(values)} rows; if packets were "
            "written more than once, leave the others out with --repeated"
        )
    kept = np.delete(np.arange(len(values)), again)
    values = values[kept]
    steps = np.diff(values)
    if (steps < 0).any():
        modulo = 1 << int(values.max()).bit_length()
        back = values[:-1][steps < 0]
        if (back < modulo * 3 // 4).any():
            at = int(np.flatnonzero(steps < 0)[0])
            raise RecordingError(
                f"{what} {kept[at + 1]}: the counter runs backwards, from {values[at]} to {values[at + 1]}"
            )
        steps = np.where(steps < 0, steps + modulo, steps)
    doubt = (
        f"{len(again)} of {len(counter)} packets have the counter of the packet before (first in row {again[0]}) and are left out"
        if len(again)
        else ""
    )
    return kept, np.concatenate([[0], steps - 1]), doubt
