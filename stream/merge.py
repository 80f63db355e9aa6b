"""Several inputs, one order: samples leave in global time order (ties: port order) as far as every input's `until` reaches."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stream.chunk import NEVER, Array, Chunk, Specs, empty


class Merge:
    """Holds back the chunks of several ports until their order is certain; drops nothing.

    The pieces that come out depend on the samples alone in their order, whatever the order and the cutting in which chunks arrived.
    """

    __slots__ = ("_pending", "_ports", "_specs", "_told", "_until")

    def __init__(self, specs: Specs) -> None:
        """`specs` by port, in port order."""
        self._ports = list(specs)
        self._specs = specs
        self._pending: list[list[Chunk]] = [[] for _ in specs]
        self._until = [NEVER] * len(specs)
        self._told = [NEVER] * len(specs)

    def push(self, port: str, chunk: Chunk) -> Iterator[tuple[str, Chunk]]:
        """Take a chunk; yields (port, piece) for everything that is now certain, then the time that has passed on each port."""
        i = self._ports.index(port)
        if len(chunk.time):
            self._pending[i].append(chunk)
        if chunk.until > self._until[i]:
            self._until[i] = chunk.until
        frontier = min(self._until)
        while (piece := self._next(frontier)) is not None:
            yield piece
        for j, name in enumerate(self._ports):
            if self._told[j] < frontier:
                self._told[j] = frontier
                yield name, empty(self._specs[name], frontier)

    def _next(self, frontier: int) -> tuple[str, Chunk] | None:
        """The longest run of one port that precedes everything else pending, cut at the frontier."""
        heads = [(int(queue[0].time[0]), j) for j, queue in enumerate(self._pending) if queue]
        if not heads or min(heads)[0] > frontier:
            return None
        first = min(heads)[1]
        limit = min([frontier, *(time - 1 if j < first else time for time, j in heads if j != first)])
        queue = self._pending[first]
        chunk = queue[0]
        n = int(chunk.time.searchsorted(limit, side="right"))
        if n < len(chunk.time):
            queue[0] = chunk.part(n, len(chunk.time))
        else:
            queue.pop(0)
        until = min(limit if n < len(chunk.time) else chunk.until, frontier)
        self._told[first] = max(self._told[first], until)
        return self._ports[first], Chunk(chunk.time[:n], chunk.data[:n], until, chunk.lost)

    def snapshot(self) -> dict[str, Array]:
        """What is held back, as plain arrays."""
        arrays: dict[str, Array] = {"until": np.array(self._until), "told": np.array(self._told)}
        for j, queue in enumerate(self._pending):
            arrays[f"{j}.n"] = np.array(len(queue))
            for k, chunk in enumerate(queue):
                arrays[f"{j}.{k}.time"], arrays[f"{j}.{k}.data"] = chunk.time, chunk.data
                arrays[f"{j}.{k}.head"] = np.array([chunk.until, chunk.lost])
        return arrays

    def restore(self, arrays: dict[str, Array]) -> None:
        self._until = [int(v) for v in arrays["until"]]
        self._told = [int(v) for v in arrays["told"]]
        for j in range(len(self._ports)):
            self._pending[j] = [_chunk(arrays, f"{j}.{k}") for k in range(int(arrays[f"{j}.n"]))]

    @property
    def held(self) -> int:
        """Chunks waiting."""
        return sum(len(queue) for queue in self._pending)


def _chunk(arrays: dict[str, Array], name: str) -> Chunk:
    until, lost = (int(v) for v in arrays[f"{name}.head"])
    return Chunk(arrays[f"{name}.time"], arrays[f"{name}.data"], until, lost)
