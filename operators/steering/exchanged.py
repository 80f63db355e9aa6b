"""Whether two markers bear each other's names: where exchanging them would bring markers back to the poses of the training."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from operators.steering.fit import Steering
from operators.steering.regions import Regions
from stream.chunk import Array, Samples

NAMED = np.dtype([("onset", "<i8"), ("what", "U9"), ("one", "U32"), ("other", "U32")])
"""At `onset` it is decided that the markers `one` and `other` are `exchanged`, or that this is `cured`."""
FAR, SAMPLES, CALM = 0.3, 10, 30
"""Markers are suspected above this distance from the training, in kernel widths. A pair is reported if exchanging it would at least halve
the distance in 10 such samples, one after the other; it is cured once 30 samples in a row are near again."""


@dataclass(slots=True)
class ExchangedNames:
    """numbers (6,): the pair to be tried next, a pair that would explain the markers (-1: none) and in how many samples it has, the pair
    that was reported (-1: none), how many samples in a row the markers have been near, and 1 where a sample was passed over."""

    numbers: Array

    @staticmethod
    def none() -> ExchangedNames:
        return ExchangedNames(np.array([0, -1, 0, -1, 0, 0]))

    def see(
        self, model: Steering, marks: Samples, far: float, time: int, regions: Regions | None = None
    ) -> tuple[int, str, str, str] | None:
        """What is to be reported of a sample at `time` (ns) whose markers (m, 3) are all seen, `far` kernel widths from the training.

        Every second sample one pair of markers is tried, so that a sample costs little: it takes m (m - 1) + 9 that are
        far, at most.
        """
        n = self.numbers
        n[4] = n[4] + 1 if far <= FAR else 0
        if n[3] >= 0:
            if n[4] < CALM:
                return None
            told, n[3:5] = int(n[3]), (-1, 0)
            return time, "cured", *_names(model, told)
        if far <= FAR:
            n[1:3] = (-1, 0) if n[4] >= CALM else n[1:3]
            return None
        n[5] = 1 - n[5] if n[1] < 0 else 0
        if n[5]:
            return None
        pairs = len(marks) * (len(marks) - 1) // 2
        tried = int(n[1] if n[1] >= 0 else n[0])
        one, other = _pairs(len(marks))[tried]
        order = np.arange(len(marks))
        order[[one, other]] = other, one
        if n[1] < 0:
            n[0] = (tried + 1) % pairs
        if regions:
            then = regions.outside(model.features(marks[None, order])[0].reshape(-1, 3), far / 2)
        else:
            then = model.outside(marks[None, order], far / 2)
        if then > far / 2:
            n[1:3] = -1, 0
            return None
        n[1], n[2] = tried, n[2] + 1
        if n[2] < SAMPLES:
            return None
        n[1:5] = -1, 0, tried, 0
        return time, "exchanged", *_names(model, tried)


def _names(model: Steering, pair: int) -> tuple[str, str]:
    """The markers of a pair, by its number."""
    one, other = _pairs(len(model.markers))[pair]
    return model.markers[one], model.markers[other]


@cache
def _pairs(count: int) -> tuple[tuple[int, int], ...]:
    return tuple(combinations(range(count), 2))
