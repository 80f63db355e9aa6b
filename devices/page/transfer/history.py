"""What the page's server remembers of each stream, bounded: the newest samples, where its line is interrupted, and how far it has come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.page.transfer.downsample import Curve, as_rows, breaks, thinned
from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times

MAX_BYTES = 8 << 20
"""Of one stream."""
MIN_SAMPLES = 2
MAX_SAMPLES = 200_000


class History:
    """The newest samples of a stream, numbered; `first` is the oldest one kept, `end` the one behind the newest."""

    def __init__(self, spec: StreamSpec, max_bytes: int = MAX_BYTES) -> None:
        self.spec = spec
        self.limit = int(np.clip(max_bytes // (spec.sample_bytes + 9), MIN_SAMPLES, MAX_SAMPLES))
        room = min(2 * self.limit, 1024)
        self._time: Times = np.empty(room, np.int64)
        self._data: Array = np.empty((room, *spec.shape), spec.dtype)
        self._broken: NDArray[np.bool_] = np.empty(room, np.bool_)
        self._from = self._to = self.first = 0

    @property
    def end(self) -> int:
        return self.first + self._to - self._from

    @property
    def time(self) -> Times:
        return self._time[self._from : self._to]

    @property
    def data(self) -> Array:
        return self._data[self._from : self._to]

    def add(self, chunk: Chunk) -> None:
        """Take further samples, and forget the oldest."""
        before = int(self._time[self._to - 1]) if self._to > self._from else None
        broken = breaks(chunk.time, chunk.lost, before, self.spec.period_ns)
        skip = max(0, len(chunk.time) - self.limit)
        if skip:
            self.first, self._from, self._to = self.end + skip, 0, 0
        n = len(chunk.time) - skip
        self._make_room(n)
        place = slice(self._to, self._to + n)
        self._time[place], self._data[place], self._broken[place] = chunk.time[skip:], chunk.data[skip:], broken[skip:]
        self._to += n
        over = self._to - self._from - self.limit
        if over > 0:
            self._from += over
            self.first += over

    def _make_room(self, n: int) -> None:
        if self._to + n <= len(self._time):
            return
        held = self._to - self._from
        room = len(self._time)
        while room < min(held + n, self.limit) + n:
            room *= 2
        for name in ("_time", "_data", "_broken"):
            old = getattr(self, name)
            new = np.empty((room, *old.shape[1:]), old.dtype)
            new[:held] = old[self._from : self._to]
            setattr(self, name, new)
        self._from, self._to = 0, held

    def since(self, number: int) -> slice:
        """Where the samples from `number` on lie, as far as they are still there, in `time` and `data`."""
        return slice(max(0, number - self.first), self._to - self._from)

    def curve(self, number: int, width_ns: int) -> tuple[Curve, int]:
        """What is to be drawn from sample `number` on, and the number to go on from: only buckets that are complete."""
        part = self.since(number)
        time = self.time[part]
        stop = len(time)
        if width_ns and stop:
            stop = int(np.searchsorted(time, time[-1] // width_ns * width_ns))
        cut = slice(part.start, part.start + stop)
        data = as_rows(self.data[cut])
        broken = self._broken[self._from : self._to][cut]
        return thinned(time[:stop], data, broken, width_ns), self.first + part.start + stop
