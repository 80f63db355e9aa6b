"""One stream that is being joined to others: the samples of it that still count, and its value at any time among them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, Samples, Times
from kinegraph.stream.kernel import kernel

LINEAR, HOLD, NEAREST = range(3)
METHODS = {"linear": LINEAR, "hold": HOLD, "nearest": NEAREST}
ROOM = 64
"""For how many samples there is room at first; room doubles when it is full."""


@kernel
def join(
    targets: Times,
    time: Times,
    data: Samples,
    furthest: int,
    method: int,
    first: int,
    out: Samples,
    near: NDArray[np.bool_],
) -> None:
    """One stream's values at the times `targets` (m,) into columns `first`, ... of `out` (m, *), from samples `time` (k,), `data` (k, c).

    NaN where no sample within `furthest` ns allows a value; `near` (m,) becomes true where one does. A sample at a target counts alone,
    the last of several at one time.
    """
    before = -1
    for i in range(targets.shape[0]):
        t = targets[i]
        while before + 1 < time.shape[0] and time[before + 1] <= t:
            before += 1
        after = before + 1
        left = before >= 0 and t - time[before] <= furthest
        right = method != HOLD and after < time.shape[0] and time[after] - t <= furthest
        exact = before >= 0 and time[before] == t
        share = 0.0
        if exact or method == HOLD:
            found = left
        elif method == LINEAR:
            found = left and right
            if found:
                share = (t - time[before]) / (time[after] - time[before])
        else:
            found = left or right
            if right and (not left or time[after] - t < t - time[before]):
                share = 1.0
        near[i] = near[i] or found
        for c in range(data.shape[1]):
            if not found:
                out[i, first + c] = math.nan
            elif share == 0.0:
                out[i, first + c] = data[before, c]
            elif share == 1.0:
                out[i, first + c] = data[after, c]
            else:
                out[i, first + c] = data[before, c] + share * (data[after, c] - data[before, c])


@dataclass(slots=True)
class AlignedInput:
    """The samples of one stream that rows may still need.

    port      the stream's name
    first     its first column in a row
    furthest  how far in time its samples count (ns)
    count     how many samples are kept
    time      (room,) their stamps; `data` (room, c) their values, NaN where they are not finite; `lost` (room,) what was lost before each
    """

    port: str
    first: int
    furthest: int
    count: int
    time: Times
    data: Samples
    lost: Times

    @staticmethod
    def empty(port: str, first: int, width: int, furthest: int) -> AlignedInput:
        room = np.zeros(ROOM, np.int64)
        return AlignedInput(port, first, furthest, 0, room, np.zeros((ROOM, width)), np.zeros_like(room))

    @property
    def times(self) -> Times:
        """Stamps of what is kept."""
        return self.time[: self.count]

    @property
    def newest(self) -> int:
        return int(self.time[self.count - 1]) if self.count else NEVER

    def take(self, chunk: Chunk) -> None:
        """Keep a chunk's samples until they are dropped; infinity as NaN, and any NaN with the bits that it has in recordings."""
        start = self.count
        stop = start + len(chunk.time)
        while stop > len(self.time):
            self.time = np.concatenate([self.time, np.zeros_like(self.time)])
            self.data = np.concatenate([self.data, np.zeros_like(self.data)])
            self.lost = np.concatenate([self.lost, np.zeros_like(self.lost)])
        self.time[start:stop] = chunk.time
        kept = self.data[start:stop]
        kept[...] = chunk.data
        kept[np.isinf(kept)] = np.nan
        self.lost[start:stop] = 0
        self.lost[start] = chunk.lost
        self.count = stop

    def drop(self, n: int) -> None:
        """Forget the oldest `n` samples."""
        if n > 0:
            self.count -= n
            for kept in (self.time, self.data, self.lost):
                kept[: self.count] = kept[n : n + self.count]

    def drop_before(self, following: int) -> None:
        """Forget what no row from `following` on needs: all before the newest sample at or before that time."""
        self.drop(int(self.times.searchsorted(following, "right")) - 1)

    def known(self, until: int) -> int:
        """Up to which time values between samples are certain, if the stream is complete up to `until`."""
        met = self.newest if self.newest <= until else self.newest - 1
        return until if until == FOREVER else min(until, max(met, until - self.furthest))

    def values(self, targets: Times, method: int, out: Samples, near: NDArray[np.bool_]) -> None:
        """Fill this stream's columns of `out` (m, *) at the times `targets` (m,); see `join`."""
        join(targets, self.times, self.data[: self.count], self.furthest, method, self.first, out, near)
