"""Two clocks by a train of pulses that both have recorded: offset, drift, and what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.errors import KinegraphError

LEAST = 3


@dataclass(frozen=True, slots=True)
class PulseMatch:
    """A time t of the second recording is t + offset_s + drift_ppm 1e-6 (t - start_s) in the first. `residual_ms`, `worst_ms`: root mean
    square and largest distance of matched pulses on that line; `matched` of `first` and `second` pulses."""

    offset_s: float
    drift_ppm: float
    start_s: float
    residual_ms: float
    worst_ms: float
    matched: int
    first: int
    second: int

    def place(self, seconds: Samples) -> Samples:
        """Times of the second recording on the first one's clock."""
        return np.asarray(seconds + self.offset_s + 1e-6 * self.drift_ppm * (seconds - self.start_s))


def match_pulses(first: Samples, second: Samples, within_s: float = 0.02, max_ppm: float = 500.0) -> PulseMatch:
    """Match two trains of pulses (n,), (m,) in s, each on its own clock; pulses may be missing or extra in either.

    The offset is that by which most pulses fall within `within_s` of one of the other train, tried from every pair of the first pulses; the
    line through the matched pairs is then fitted by least squares, three times. Raises KinegraphError where fewer than three pulses match,
    where another offset matches as many (pulses at even intervals say nothing of which is which), or the drift is beyond `max_ppm`.
    """
    first, second = np.sort(np.asarray(first, float)), np.sort(np.asarray(second, float))
    if min(len(first), len(second)) < LEAST:
        raise KinegraphError(f"{len(first)} and {len(second)} pulses: three in each are needed")
    wide = within_s + 1e-6 * max_ppm * float(np.ptp(second))
    offsets = np.unique(np.round((first[:, None] - second[None, :64]).ravel(), 6))
    counts = np.array([_within(first, second + offset, wide) for offset in offsets.tolist()])
    best = float(offsets[counts == counts.max()][(counts == counts.max()).sum() // 2])
    others = counts[np.abs(offsets - best) > 4 * wide]
    if counts.max() < LEAST:
        raise KinegraphError(
            f"no offset brings three pulses within {1000 * within_s:g} ms of each other: are these the same pulses?"
        )
    if len(others) and others.max() >= 0.9 * counts.max():
        raise KinegraphError(
            "several offsets fit as well: pulses at even intervals; send some at uneven ones, or cut one recording"
        )
    slope, offset = 0.0, best
    start = float(second[0])
    for limit in (wide, 2 * within_s, within_s):
        moved = second + offset + slope * (second - start)
        near = _nearest(first, moved)
        good = np.abs(first[near] - moved) <= limit
        if good.sum() < LEAST:
            raise KinegraphError(f"only {int(good.sum())} pulses match: are these the same pulses?")
        slope, offset = (float(v) for v in np.polyfit(second[good] - start, (first[near] - second)[good], 1))
    rest = (first[near] - second - offset - slope * (second - start))[good]
    if abs(slope) > 1e-6 * max_ppm:
        raise KinegraphError(f"the clocks would drift by {1e6 * slope:.0f} ppm; more than {max_ppm:g} is not a clock's")
    rms, worst = float(np.sqrt((rest**2).mean())), float(np.abs(rest).max())
    return PulseMatch(offset, 1e6 * slope, start, 1000 * rms, 1000 * worst, int(good.sum()), len(first), len(second))


def _nearest(times: Samples, wanted: Samples) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Which of `times` is nearest to each of `wanted`."""
    right = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    return np.where(wanted - times[right - 1] < times[right] - wanted, right - 1, right)


def _within(times: Samples, wanted: Samples, limit: float) -> int:
    return int((np.abs(times[_nearest(times, wanted)] - wanted) <= limit).sum())
