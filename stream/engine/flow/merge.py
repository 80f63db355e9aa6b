"""Several inputs, one order: samples leave in global time order, at equal stamps those of triggers last, as far as every input's
`until` reaches."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, Array, Chunk, Specs, add_lost, empty
from kinegraph.stream.operator import ANY, Input, input_of


class Merge:
    """Holds back the chunks of several ports until their order is certain; drops nothing.

    The samples that come out, in their order, depend on the samples that went in alone, not on the cutting or on which port's chunk came
    first. A piece's `until` holds for all ports at once: whatever comes later, on any port, is later than that.
    """

    __slots__ = (
        "_clocked",
        "_empty",
        "_in_turn",
        "_index",
        "_lost",
        "_next",
        "_pending",
        "_ports",
        "_promised",
        "_stamps",
        "_start",
        "_until",
    )

    def __init__(self, specs: Specs, inputs: Mapping[str, Input] = MappingProxyType({ANY: Input()})) -> None:
        """`specs` by port, and how the operator declares its `inputs`."""
        triggers = [port for port in inputs if inputs[port].trigger and port in specs]
        self._ports = [*(port for port in specs if port not in triggers), *triggers]
        self._in_turn = [input_of(inputs, port).in_turn for port in self._ports]
        self._index = {port: i for i, port in enumerate(self._ports)}
        self._empty = [empty(specs[port], NEVER) for port in self._ports]
        n = len(specs)
        self._clocked = range(n - len(triggers) if triggers else 0, n)
        """The ports on which time passes without samples: every one more costs a call of the operator, and of all behind it."""
        self._pending: list[deque[Chunk]] = [deque() for _ in range(n)]
        self._start = [0] * n
        """How many samples of each port's first pending chunk have gone out."""
        self._next = [FOREVER] * n
        """The stamp of each port's next sample; FOREVER if nothing is pending."""
        self._stamps: list[list[int]] = [[] for _ in range(n)]
        """The stamps of each port's first pending chunk, once it had to be cut."""
        self._until = [NEVER] * n
        self._promised = [NEVER] * n
        self._lost = [0] * n

    def push(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        """Take a chunk; gives (port, piece) for everything that is now certain, then the time that has passed."""
        i = self._index[port]
        if len(chunk.time):
            self._append(i, chunk)
        elif chunk.lost:
            self._lost[i] = add_lost(self._lost[i], chunk.lost)
        if chunk.until > self._until[i]:
            self._until[i] = chunk.until
        frontier = min(self._until)
        pieces: list[tuple[str, Chunk]] = []
        while (earliest := min(self._next)) <= frontier and earliest != FOREVER:
            first = self._next.index(earliest)
            pieces.append((self._ports[first], self._take(first, frontier)))
        for j in self._clocked if frontier < FOREVER else range(len(self._ports)):
            if self._promised[j] < frontier:
                self._promised[j] = frontier
                nothing = self._empty[j]
                pieces.append((self._ports[j], Chunk(nothing.time, nothing.data, frontier)))
        return pieces

    def _append(self, i: int, chunk: Chunk) -> None:
        if self._lost[i]:
            chunk = Chunk(chunk.time, chunk.data, chunk.until, add_lost(self._lost[i], chunk.lost))
            self._lost[i] = 0
        if not self._pending[i]:
            self._next[i] = int(chunk.time[0])
        self._pending[i].append(chunk)

    def _take(self, first: int, frontier: int) -> Chunk:
        """The longest run of one port's first pending chunk that precedes what is pending on the others, cut at the frontier."""
        limit = promised = frontier
        for j, time in enumerate(self._next):
            if time <= frontier and j != first and time != FOREVER:
                if time <= promised:
                    promised = time - 1
                if self._in_turn[first]:
                    limit = min(limit, time if j > first else time - 1)
        queue = self._pending[first]
        chunk, start, stamps = queue[0], self._start[first], self._stamps[first]
        size = len(chunk.time)
        if (stamps[-1] if stamps else int(chunk.time[-1])) <= limit:
            stop = size
            queue.popleft()
            self._start[first] = 0
            self._stamps[first] = []
            self._next[first] = int(queue[0].time[0]) if queue else FOREVER
            after = chunk.until
        else:
            if not stamps:
                stamps = self._stamps[first] = chunk.time.tolist()
            stop = self._start[first] = bisect_right(stamps, limit, start)
            self._next[first] = stamps[stop]
            after = stamps[stop] - 1
        if after < promised:
            promised = after
        if promised < self._promised[first]:
            promised = self._promised[first]
        self._promised[first] = promised
        if stop - start == size:
            return chunk if chunk.until == promised else Chunk(chunk.time, chunk.data, promised, chunk.lost)
        return Chunk(chunk.time[start:stop], chunk.data[start:stop], promised, 0 if start else chunk.lost)

    def snapshot(self) -> dict[str, Array]:
        """What is held back, as plain arrays."""
        arrays: dict[str, Array] = {
            "until": np.array(self._until, np.int64),
            "told": np.array(self._promised, np.int64),
            "lost": np.array(self._lost, np.int64),
        }
        for j, queue in enumerate(self._pending):
            chunks = list(queue)
            if self._start[j]:
                chunks[0] = chunks[0].part(self._start[j], len(chunks[0]))
            arrays[f"{j}.lengths"] = np.array([len(c) for c in chunks], np.int64)
            arrays[f"{j}.until"] = np.array([c.until for c in chunks], np.int64)
            arrays[f"{j}.lost"] = np.array([c.lost for c in chunks], np.int64)
            arrays[f"{j}.time"] = np.concatenate([self._empty[j].time, *(c.time for c in chunks)])
            arrays[f"{j}.data"] = np.concatenate([self._empty[j].data, *(c.data for c in chunks)])
        return arrays

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from a snapshot of a merge of the same ports."""
        self._until = arrays["until"].tolist()
        self._promised = arrays["told"].tolist()
        self._lost = arrays["lost"].tolist()
        for j in range(len(self._ports)):
            time, data = arrays[f"{j}.time"], arrays[f"{j}.data"]
            stops = np.cumsum(arrays[f"{j}.lengths"]).tolist()
            heads = zip([0, *stops], stops, arrays[f"{j}.until"].tolist(), arrays[f"{j}.lost"].tolist(), strict=False)
            self._pending[j] = deque(Chunk(time[a:b], data[a:b], until, lost) for a, b, until, lost in heads)
            self._start[j] = 0
            self._stamps[j] = []
            self._next[j] = int(time[0]) if len(time) else FOREVER

    @property
    def held(self) -> int:
        """Chunks waiting."""
        return sum(len(queue) for queue in self._pending)
