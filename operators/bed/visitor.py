"""A small body that walks about on the bed, such as a cat: raised apart from the sleeper, now here, now there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

NEWEST_S = 10
"""What was raised so long ago and is flat now has been left."""
FLAT = 0.5
"""Flat: below this share of what makes raised."""
LEAST_BLOCKS = 2
HOLD_S = 15
"""Who stands still for so long is no longer expected to walk on."""


@kernel
def apart(raised: Times, label: Times, stack: Times) -> int:
    """Label connected parts (corners count) of `raised` (rows, columns; 0 or 1) from 1 on; returns the largest one's label, 0 if empty.

    label (rows, columns), written; stack (rows * columns,), scratch
    """
    rows, columns = raised.shape
    label[:] = 0
    largest, most, found = 0, 0, 0
    for start in range(rows * columns):
        if raised[start // columns, start % columns] == 0 or label[start // columns, start % columns] != 0:
            continue
        found += 1
        size, depth = 1, 1
        label[start // columns, start % columns] = found
        stack[0] = start
        while depth > 0:
            depth -= 1
            row, column = stack[depth] // columns, stack[depth] % columns
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    if raised[r, c] != 0 and label[r, c] == 0:
                        label[r, c] = found
                        stack[depth] = r * columns + c
                        depth += 1
                        size += 1
        if size > most:
            largest, most = found, size
    return largest


@dataclass(slots=True)
class RoamingBody:
    """
    second            how many seconds have been looked at
    raised, flat      (rows, columns)  the second in which a block was last raised apart from the sleeper, and last flat; -1: never
    walked            (k,)  the second in which something last walked in a region; -1: never
    """

    second: int
    raised: Times
    flat: Times
    walked: Times

    @staticmethod
    def of(k: int, shape: tuple[int, ...]) -> RoamingBody:
        return RoamingBody(0, np.full(shape, -1), np.full(shape, -1), np.full(k, -1))

    def forget(self) -> None:
        """The picture is another one."""
        self.raised[:] = self.flat[:] = self.walked[:] = -1

    def left(self, k: int) -> None:
        """The bed is empty."""
        self.walked[k] = -1

    def here(self, k: int) -> bool:
        """Whether something has walked within the newest seconds."""
        return bool(self.walked[k] >= 0 and self.second - self.walked[k] < HOLD_S)

    def look(self, k: int, part: tuple[slice, slice], above: Samples, rise: float) -> None:
        """A second of a region's `part`, `above` (rows, columns) mm the empty bed, NaN: not known.

        It walks where it is raised on what was flat within the newest seconds, and has left as much flat behind it: a limb stays where it
        is, and who turns over stays in one piece.
        """
        up = np.ascontiguousarray(above > rise).astype(np.int64)
        label, stack = np.empty_like(up), np.empty(up.size, np.int64)
        largest = apart(up, label, stack)
        island = (label > 0) & (label != largest)
        raised, flat = self.raised[part], self.flat[part]
        flat[above < FLAT * rise] = self.second
        came = island & (flat >= 0) & (self.second - flat < NEWEST_S)
        gone = (flat == self.second) & (raised >= 0) & (self.second - raised < NEWEST_S)
        raised[island] = self.second
        least = max(LEAST_BLOCKS, int(island.sum()) // 2)
        if island.any() and came.sum() >= least and gone.sum() >= least:
            self.walked[k] = self.second
