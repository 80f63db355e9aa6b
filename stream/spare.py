"""Arrays for what operators give out, taken again once nobody holds them: a fresh one costs as much as most operators' work on it.

Whether somebody holds an array is what the interpreter counts anyway. An array that only its `Spare` holds cannot be reached from anywhere
else: no chunk, no view, no queue has it, and nobody can come by it. So what has been emitted is still never written again while anyone
could see it.
"""

from __future__ import annotations

import sys
from sys import getrefcount

import numpy as np

from stream.chunk import STAMP, Samples, Times


class Spare:
    """Rows of float64 and stamps for one output; no part of an operator's state.

    width   numbers per row
    """

    __slots__ = ("_both", "_rows", "_stamps", "_width")

    def __init__(self, width: int) -> None:
        self._width = width
        self._rows: Samples = np.empty((0, width))
        self._stamps: Times = np.empty(0, STAMP)
        self._both = 0  # their common length; -1: they differ

    def rows(self, n: int) -> Samples:
        """An array (n, width) that nobody else holds; what is in it is left over."""
        rows = self._rows
        if getrefcount(rows) == ALONE and len(rows) == n:
            return rows
        rows = self._rows = np.empty((n, self._width))
        self._both = -1
        return rows

    def both(self, n: int) -> tuple[Samples, Times]:
        """As `rows`, with stamps (n,)."""
        rows, stamps = self._rows, self._stamps
        if n == self._both and getrefcount(rows) == ALONE and getrefcount(stamps) == ALONE:
            return rows, stamps
        self._both = n
        rows, stamps = self._rows, self._stamps = np.empty((n, self._width)), np.empty(n, STAMP)
        return rows, stamps


ALONE = 0
"""What the interpreter counts, as it is asked above, for an array that only its `Spare` holds; 0: arrays are always fresh."""


def _find_out() -> None:
    """Set `ALONE` by trying. It stays 0 where nothing tells, and where threads run at the same time."""
    global ALONE
    if getattr(sys, "_is_gil_enabled", lambda: True)():
        for count in range(1, 6):
            ALONE = count
            if _tells(Spare(1)):
                return
    ALONE = 0


def _tells(spare: Spare) -> bool:
    """Whether arrays are taken again when nobody holds them, and only then."""
    if id(spare.rows(1)) != id(spare.rows(1)) or id(spare.both(1)[1]) != id(spare.both(1)[1]):
        return False
    rows = spare.rows(1)
    if spare.rows(1) is rows:
        return False
    both = spare.both(1)
    return all(now is not before for now, before in zip(spare.both(1), both, strict=True))


_find_out()
