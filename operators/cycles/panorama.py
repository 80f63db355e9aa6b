"""A cycle joined to its neighbours: -50..149 %, as the thesis's outlook proposes (6.4.1), so that no burst is cut in two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples


@dataclass(slots=True)
class Panorama:
    """The latest cycle, (points, channels), if `whole` > 0, and the one before it, if `whole` > 1."""

    last: Samples
    before: Samples
    whole: int

    @staticmethod
    def empty(points: int, channels: int) -> Panorama:
        return Panorama(np.zeros((points, channels)), np.zeros((points, channels)), 0)

    def follow(self, cycle: Samples | None) -> Samples | None:
        """Take the next cycle (None: it was rejected); gives the view (2 points, channels) of the one before it, if there was one."""
        half = len(self.last) // 2
        view = None
        if self.whole:
            view = np.full((4 * half, self.last.shape[1]), np.nan)
            view[half : 3 * half] = self.last
            if self.whole > 1:
                view[:half] = self.before[half:]
            if cycle is not None:
                view[3 * half :] = cycle[:half]
        if cycle is None:
            self.whole = 0
        else:
            self.before[...] = self.last
            self.last[...] = cycle
            self.whole = min(self.whole + 1, 2)
        return view
