"""Arrays for what operators give out, taken again once nobody holds them: a fresh one costs as much as most operators' work on it.

Whether somebody holds an array is what the interpreter counts anyway. An array that only its `Spare` holds cannot be reached from anywhere
else: no chunk, no view, no queue has it, and nobody can come by it. So what has been emitted is still never written again while anyone
could see it.
"""

from __future__ import annotations

from sys import getrefcount

import numpy as np

from stream.chunk import STAMP, Samples, Times


class Spare:
    """Rows of float64 and stamps for one output; no part of an operator's state.

    width   numbers per row
    """

    __slots__ = ("_rows", "_stamps", "_width")

    def __init__(self, width: int) -> None:
        self._width = width
        self._rows: Samples = np.empty((0, width))
        self._stamps: Times = np.empty(0, STAMP)

    def rows(self, n: int) -> Samples:
        """An array (n, width) that nobody else holds; what is in it is left over."""
        rows = self._rows
        if getrefcount(rows) == ALONE and len(rows) == n:
            return rows
        rows = self._rows = np.empty((n, self._width))
        return rows

    def both(self, n: int) -> tuple[Samples, Times]:
        """As `rows`, with stamps (n,)."""
        rows, stamps = self._rows, self._stamps
        if getrefcount(rows) != ALONE or len(rows) != n:
            rows = self._rows = np.empty((n, self._width))
        if getrefcount(stamps) != ALONE or len(stamps) != n:
            stamps = self._stamps = np.empty(n, STAMP)
        return rows, stamps


def _alone() -> int:
    """What this interpreter counts for an array in an attribute that is looked at as above."""
    spare = Spare(1)
    rows = spare._rows
    return getrefcount(rows)


ALONE = _alone()
