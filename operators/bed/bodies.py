"""One body in a region of the bed, or two: by how much is raised above the empty bed, or has come since there was one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.bed.frames.seconds import look
from kinegraph.stream.chunk import Samples, Times

CROWD, ALONE = 1.4, 1.2
"""A second body: from this many times on, and down to this many times, the share that one body raises."""
TWO = 1.7
"""Where only what has changed since is known: this many times, so that one of two has gone once half of what one raises has."""
CROWD_S, ALONE_S, EARLY_S = 30, 300, 60
"""For this long; and so long after lying down the share of one body is known, and so long its first guess."""
HIGH, BULK = 0.6, 1.3
"""Until it is known, a second body also has to be high: blocks above this share of the median of those that are raised count, and the mean
height is this many times as large. So who sits and then lies down, or pulls a blanket up, stays one."""
SUSPECT_S = 3
"""After so long there may be two."""


@dataclass(slots=True)
class Bodies:
    """
    alone   (k, 4)           of the first seconds in bed with one body, summed: the share that it raises, how many seconds, the share that
                             is high, and the mean height
    crowd   (k,)             seconds in a row that say otherwise than `two` (k,): whether there are two
    taken   (rows, columns)  while the empty bed is not known: the bed's depth with who is in it; NaN where not known
    began   (k,)             how many times as much as one body raises that is held to have been: 1, or for two `TWO`
    plane   (k, 3)           of the empty bed as it was known last: depth at the frame's corner, and more of it per row and column
    blocks  (k,)             of the region that `alone` was learned in, after the camera was moved; else 0
    """

    alone: Samples
    crowd: Times
    two: Times
    taken: Samples
    began: Samples
    plane: Samples
    blocks: Times

    @staticmethod
    def of(k: int, shape: tuple[int, ...]) -> Bodies:
        crowd, two = np.zeros(k, np.int64), np.zeros(k, np.int64)
        return Bodies(
            np.zeros((k, 4)),
            crowd,
            two,
            np.full(shape, np.nan),
            np.ones(k),
            np.full((k, 3), np.nan),
            np.zeros(k, np.int64),
        )

    def moved(self, empty: Samples, regions: Times) -> None:
        """The camera was: all lies elsewhere in the picture now; of the `empty` bed (rows, columns) only its plane still holds."""
        self.taken[:] = np.nan
        self.crowd[:] = 0
        for k, (row, column, rows, columns) in enumerate(regions.tolist()):
            self.blocks[k] = self.blocks[k] or (rows * columns if self.alone[k, 1] else 0)
            depth = empty[row : row + rows, column : column + columns]
            known = np.isfinite(depth)
            if known.sum() > 3:
                down, right = np.nonzero(known)
                terms = np.stack([np.ones(len(down)), down + row, right + column], axis=1)
                self.plane[k] = np.linalg.lstsq(terms, depth[known], rcond=None)[0]

    def left(self, k: int) -> None:
        """The bed is empty."""
        self.alone[k], self.crowd[k], self.two[k], self.blocks[k] = 0.0, 0, 0, 0

    def take(self, k: int, part: tuple[slice, slice], depth: Samples, rise: float) -> None:
        """Start counting from `depth` (rows, columns) in the `part` of an occupied region with unknown empty depth.

        What stands out of the plane in which the bed lay before the camera was moved shows whether these are two. A region that is found
        again may be smaller or larger: one body is as many blocks as it was, and so another share of it.
        """
        if np.isfinite(self.taken[part]).any():
            return
        if self.blocks[k]:
            self.alone[k, [0, 2, 3]] *= self.blocks[k] / depth.size
            self.blocks[k] = 0
        self.taken[part] = depth
        rows, columns = np.mgrid[part]
        above = self.plane[k, 0] + self.plane[k, 1] * rows + self.plane[k, 2] * columns - depth
        above = above[np.isfinite(above)]
        if self.known(k) and len(above):
            self.two[k] = int(float(np.mean(above > rise)) >= CROWD * self._one(k))
        self.began[k] = TWO if self.two[k] else 1.0

    def known(self, k: int) -> bool:
        return bool(self.alone[k, 1] >= ALONE_S)

    def _one(self, k: int) -> float:
        return float(self.alone[k, 0] / self.alone[k, 1])

    def early(self, k: int, high: float, height: float) -> float:
        """The same before that is known, by the share that is `high` and the mean `height`; NaN: not even this is known."""
        _, seconds, highs, heights = (float(value) for value in self.alone[k])
        if seconds < EARLY_S or not highs > 0.0 or not heights > 0.0:
            return math.nan
        return min(high * seconds / highs, height * seconds / heights * CROWD / BULK)

    def times(self, k: int, raised: float, mean: Samples, regions: Times, rise: float) -> float:
        """How many times the share of one body is raised; NaN: not known. `raised`: the share above the empty bed, NaN: unknown."""
        if not self.known(k):
            return math.nan
        one = self._one(k)
        if raised != raised:
            raised = one * float(self.began[k]) + self._come(k, mean, regions, rise)
        return raised / one

    def learn(self, k: int, raised: float, high: float, height: float) -> None:
        """A second, with one body as far as is known: what it raises, how much of it is high, and how high the region is."""
        if raised == raised and not self.known(k) and not self.two[k] and not self.crowd[k]:
            self.alone[k] += raised, 1.0, high, height

    def count(self, k: int, times: float) -> bool:
        """One more second, of this many times one body; whether there are now as many as were not there before, for 30 s."""
        other = times < ALONE if self.two[k] else times >= CROWD
        self.crowd[k] = self.crowd[k] + 1 if other else 0
        if self.crowd[k] < CROWD_S:
            return False
        self.two[k], self.crowd[k] = 1 - self.two[k], 0
        return True

    def suspected(self, k: int) -> bool:
        """Whether there are two, or may be."""
        return bool(self.two[k] or self.crowd[k] >= SUSPECT_S)

    def _come(self, k: int, mean: Samples, regions: Times, rise: float) -> float:
        """The share of the region that is higher than `taken`, less what is lower: who turns over only moves it."""
        higher, lower = np.full((len(regions), 3), np.nan), np.full((len(regions), 3), np.nan)
        look(mean, self.taken, regions, rise, higher)
        look(-mean, -self.taken, regions, rise, lower)
        return float(higher[k, 0] - lower[k, 0])


def share_high(above: Samples, rise: float) -> float:
    """Of the blocks `above` the empty bed (NaN: not known), the share higher than `HIGH` of the median of those above `rise`."""
    known = above[np.isfinite(above)]
    raised = known[known > rise]
    return float((known > HIGH * np.median(raised)).mean()) if len(raised) else 0.0
