"""Whether two markers bear each other's names: where exchanging them would bring markers back to the poses of the training."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from kinegraph.operators.steering.model.fit import Steering
from kinegraph.operators.steering.model.regions import Regions
from kinegraph.stream.chunk import Array, Samples

NAMED = np.dtype([("onset", "<i8"), ("what", "U9"), ("one", "U32"), ("other", "U32")])
"""At `onset` it is decided that the markers `one` and `other` are `exchanged`, or that this is `cured`."""
FAR, SAMPLES, CALM = 0.3, 10, 30
"""Markers are suspected above this distance from the training, in kernel widths. A pair is believed if exchanging it would at least halve
the distance in 10 such samples, one after the other; it is cured once 30 samples in a row are near again."""
ALIKE = 0.8
"""Two pairs differ if one leaves at most this share of the distance that the other leaves, in the sum of 10 samples."""


@dataclass(slots=True)
class ExchangedNames:
    """numbers (9,): the pair to be tried next, a pair that would explain the markers (or -1) and in how many samples it has, the pair
    that was reported (or -1), how many samples in a row the markers have been near, and 1 where a sample was passed over; then how
    many other pairs it has been held against, in how many samples the one after them, and 1 where one of them explains them as well.

    sums (2,): what the pair and that other one leave of the distance, in these samples.
    """

    numbers: Array
    sums: Samples

    @staticmethod
    def empty() -> ExchangedNames:
        return ExchangedNames(np.array([0, -1, 0, -1, 0, 0, 0, 0, 0]), np.zeros(2))

    def see(
        self, model: Steering, marks: Samples, far: float, time: int, regions: Regions | None = None
    ) -> tuple[int, str, str, str] | None:
        """The event of a sample at `time` (ns) with all markers (m, 3) seen, `far` kernel widths from the training, or None.

        Every second sample one pair of markers is tried, so that a sample costs little: it takes m (m - 1) + 9 that are far to find one,
        at most. Then it is held against every other pair, one a sample, and against one that might do as well in 10 samples. The better
        one is reported; if two are alike, neither is.
        """
        n = self.numbers
        n[4] = n[4] + 1 if far <= FAR else 0
        if n[3] >= 0:
            if n[4] < CALM:
                return None
            reported, n[3:5] = int(n[3]), (-1, 0)
            return time, "cured", *_names(model, reported)
        if far <= FAR:
            if n[4] >= CALM:
                self._take(-1)
            return None
        n[5] = 1 - n[5] if n[1] < 0 else 0
        if n[5]:
            return None
        tried = int(n[1] if n[1] >= 0 else n[0])
        then = _outside(model, marks, tried, far / 2 if n[2] < SAMPLES else far, regions)
        if n[2] >= SAMPLES:
            return self._held(model, marks, (far, then), time, regions)
        if n[1] < 0:
            n[0] = (tried + 1) % len(_pairs(len(marks)))
        if then > far / 2:
            self._take(-1)
        else:
            n[1], n[2] = tried, n[2] + 1
        return None

    def _take(self, pair: int, samples: int = 0) -> None:
        """Take a pair (or -1) that has explained this number of samples; it has not been compared with any other."""
        self.numbers[1:3], self.numbers[6:9], self.sums[:] = (pair, samples), 0, 0.0

    def _held(
        self, model: Steering, marks: Samples, left: tuple[float, float], time: int, regions: Regions | None
    ) -> tuple[int, str, str, str] | None:
        """Hold the pair, which leaves `left[1]` of the distance `left[0]`, against the next other one; report it after the last."""
        n, (far, then), count = self.numbers, left, len(_pairs(len(marks)))
        if then > far:
            self._take(-1)
            return None
        pair = int(n[1])
        if n[6] < count - 1:
            other = (pair + 1 + int(n[6])) % count
            enough = np.inf if n[7] else then / ALIKE
            others = _outside(model, marks, other, enough, regions)
            if not n[7] and others > enough:
                n[6] += 1
            else:
                n[7] += 1
                self.sums += then, others
            if n[7] == SAMPLES:
                if self.sums[1] < ALIKE * self.sums[0]:
                    self._take(other, SAMPLES)
                    return None
                n[8] = max(n[8], int(self.sums[0] >= ALIKE * self.sums[1]))
                n[6], n[7], self.sums[:] = n[6] + 1, 0, 0.0
        if n[6] < count - 1:
            return None
        unsure = bool(n[8])
        self._take(-1)
        if unsure:
            return None
        n[3:5] = pair, 0
        return time, "exchanged", *_names(model, pair)


def _outside(model: Steering, marks: Samples, pair: int, enough: float, regions: Regions | None) -> float:
    """How far markers (m, 3) are from the training with a pair of them exchanged; or some distance larger than `enough`."""
    one, other = _pairs(len(marks))[pair]
    order = np.arange(len(marks))
    order[[one, other]] = other, one
    if regions:
        return regions.outside(model.features(marks[None, order])[0].reshape(-1, 3), enough)
    return model.outside(marks[None, order], enough)


def _names(model: Steering, pair: int) -> tuple[str, str]:
    """The markers of a pair, by its number."""
    one, other = _pairs(len(model.markers))[pair]
    return model.markers[one], model.markers[other]


@cache
def _pairs(count: int) -> tuple[tuple[int, int], ...]:
    return tuple(combinations(range(count), 2))
