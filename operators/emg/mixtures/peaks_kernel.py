"""Peaks of a mean curve, found by its smoothed second difference (Mariscotti 1967, as the thesis uses it in 6.2.4)."""

from __future__ import annotations

from math import inf

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def second_difference(curve: Samples, width: int, passes: int, circular: bool, out: Samples, scratch: Samples) -> None:
    """Mariscotti's smoothed second difference of `curve` (n,) into `out`: `passes` running means over `width` points, width odd.

    At the ends of a curve that is not circular the nearest value is repeated.
    """
    n, half = curve.shape[0], width // 2
    for i in range(n):
        before, after = i - 1, i + 1
        if circular:
            before, after = before % n, after % n
        else:
            before, after = max(before, 0), min(after, n - 1)
        out[i] = curve[after] - 2.0 * curve[i] + curve[before]
    for _ in range(passes):
        for i in range(n):
            total = 0.0
            for d in range(-half, half + 1):
                at = (i + d) % n if circular else min(max(i + d, 0), n - 1)
                total += out[at]
            scratch[i] = total / width
        out[:] = scratch


@kernel
def find_peaks(
    curve: Samples, width: int, passes: int, least: float, circular: bool, places: Samples, scratch: Samples
) -> int:
    """Mariscotti's peaks: where the smoothed second difference has a negative minimum of more than `least` of the deepest one.

    curve    (n,) a mean cycle; a place is its index
    places   (most,) in order, written; returns how many were found, at most as many as fit
    scratch  (2, n)

    Source: Mariscotti, Nucl. Instrum. Methods 50 (1967). He compares a minimum with the counting statistics of a spectrum; a
    mean muscle curve has no such statistics, so a minimum is compared with the curve's own deepest one.
    """
    n = curve.shape[0]
    second = scratch[0]
    second_difference(curve, width, passes, circular, second, scratch[1])
    deepest = 0.0
    for i in range(n):
        deepest = min(deepest, second[i])
    found = 0
    for i in range(n):
        before = second[(i - 1) % n] if circular or i > 0 else inf
        after = second[(i + 1) % n] if circular or i < n - 1 else inf
        if second[i] < least * deepest and second[i] < before and second[i] <= after and found < places.shape[0]:
            places[found] = i
            found += 1
    return found
