"""The line below the differences of two clocks, and stamps by it: the kernels of `DeviceClock`."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import STAMP, Samples, Times
from kinegraph.stream.kernel import kernel


@kernel
def line_below(
    x: Times, y: Times, n: int, steady: int, max_drift: float, steepest: float, clear: float, hull: Times, rest: Samples, out: Samples
) -> int:  # fmt: skip
    """The edge, over the middle of what is known, of the lower convex hull of the first n > 0 of the points `x`, `y` (m,), x increasing.

    hull, rest   (m,) memory
    out          slope, height above y[0] at the point with the returned index, median of how far the points are above the line

    Below `steady` points the slope is 0. One above `max_drift` is believed up to `steepest`, where it is `clear` times the stray.
    """
    at, slope = 0, 0.0
    if n < steady:
        for i in range(1, n):
            if y[i] < y[at]:
                at = i
        height = np.float64(y[at] - y[0])
    else:
        size = 0
        for i in range(n):
            while size > 1:
                a, b = hull[size - 2], hull[size - 1]
                if np.float64(x[b] - x[a]) * np.float64(y[i] - y[a]) > np.float64(y[b] - y[a]) * np.float64(
                    x[i] - x[a]
                ):
                    break
                size -= 1
            hull[size] = i
            size += 1
        middle = 0.0
        for i in range(n):
            middle += np.float64(x[i] - x[0])
        middle /= n
        edge = 1
        while edge < size - 1 and np.float64(x[hull[edge]] - x[0]) < middle:
            edge += 1
        at, right = hull[edge - 1], hull[edge]
        slope = np.float64(y[right] - y[at]) / np.float64(x[right] - x[at])
        if slope > max_drift:
            for i in range(n):
                rest[i] = np.float64(y[i] - y[at]) - slope * np.float64(x[i] - x[at])
            stray = middle_of(rest, n)
            believed = (slope - max_drift) * np.float64(x[n - 1] - x[0]) > clear * stray
            slope = min(slope, steepest if believed else max_drift)
        slope = max(slope, -max_drift)
        below = 0.0
        for i in range(n):
            below = min(below, np.float64(y[i] - y[at]) - slope * np.float64(x[i] - x[at]))
        height = np.float64(y[at] - y[0]) + below
    for i in range(n):
        rest[i] = np.float64(y[i] - y[0]) - height - slope * np.float64(x[i] - x[at])
    out[0], out[1], out[2] = slope, height, middle_of(rest, n)
    return at


@kernel
def middle_of(values: Samples, n: int) -> float:
    """The median of the first n > 0 values, which are put in order."""
    for i in range(1, n):
        value, place = values[i], i
        while place and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return float((values[(n - 1) // 2] + values[n // 2]) / 2)


@kernel
def even_stamps(
    last_ns: int, step_ns: float, at: int, slope: float, height: float, shift_ns: int, device: Times, stamp: Times
) -> None:
    """`device` (n,): times of records `step_ns` apart, of which the last was made at `last_ns`; `stamp` (n,): theirs by the line that has
    `height` at the device time `at`, all shifted."""
    n = len(device)
    for i in range(n):
        device[i] = last_ns - np.int64(np.rint(step_ns * (n - 1 - i)))
        stamp[i] = device[i] + np.int64(np.rint((device[i] - at) * slope + height)) + shift_ns


def prepare() -> None:
    """Compile them, or take them from the cache."""
    times, memory = np.arange(3, dtype=STAMP), np.zeros(3)
    line_below(times, times.copy(), 3, 2, 1e-3, 0.03, 20.0, times.copy(), memory, np.zeros(3))
    even_stamps(2, 1.0, 0, 0.0, 0.0, 0, times.copy(), times.copy())
