"""One gait cycle on a grid of per cent, and its local maxima."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel


@kernel
def normalise_time(time: Times, data: Samples, onset: int, duration: int, out: Samples) -> None:
    """Read `data` (n, c), stamped `time` (n,), at onset + p % of `duration` (ns) for p = -1, 0, ..., 100; write (102, c) to `out`.

    Between two samples the curve is the cubic with their values and with slopes that are those of the parabola through each sample and
    its two neighbours (on an even grid: Catmull-Rom, Keys' cubic convolution). Exact for parabolas; at 120 Hz a 10 Hz wave is off by
    0.3 % at most, where straight lines would be off by 3.4 %. What is flat stays so to the last bit, and gives no maxima by rounding.
    NaN where one of the four samples around is missing or NaN.
    """
    n = time.shape[0]
    i = 0
    for p in range(out.shape[0]):
        at = (p - 1) * duration / 100.0
        while i + 1 < n and time[i + 1] - onset <= at:
            i += 1
        if i < 1 or i + 2 >= n or time[i] - onset > at:
            for c in range(out.shape[1]):
                out[p, c] = math.nan
            continue
        before, width, after = (
            float(time[i] - time[i - 1]),
            float(time[i + 1] - time[i]),
            float(time[i + 2] - time[i + 1]),
        )
        s = (at - (time[i] - onset)) / width
        rest = 1.0 - s
        for c in range(out.shape[1]):
            slope = (data[i + 1, c] - data[i, c]) / width
            left = ((data[i, c] - data[i - 1, c]) / before * width + slope * before) / (before + width)
            right = (slope * after + (data[i + 2, c] - data[i + 1, c]) / after * width) / (width + after)
            rise = s * s * (3.0 - 2.0 * s) * (data[i + 1, c] - data[i, c])
            out[p, c] = data[i, c] + rise + width * s * rest * (rest * left - s * right)


@kernel
def maxima(curve: Samples, place: Times, height: Samples) -> int:
    """Local maxima of `curve` (102, c) at 0..99 % (rows 1..100): higher than what stands before and after, the first of equal ones.

    Written channel by channel: place (m, 2) channel and per cent, height (m,). Returns how many; m = 50 c suffices.
    """
    found = 0
    for c in range(curve.shape[1]):
        for p in range(1, curve.shape[0] - 1):
            if not curve[p, c] > curve[p - 1, c]:
                continue
            q = p + 1
            while q < curve.shape[0] - 1 and curve[q, c] == curve[p, c]:
                q += 1
            if curve[q, c] < curve[p, c]:
                place[found, 0], place[found, 1] = c, p - 1
                height[found] = curve[p, c]
                found += 1
    return found
