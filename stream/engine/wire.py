"""Between operators: a wire carries the chunks of one output to all who read it.

`Wire.carry` does so for chunks of any kind. What comes most, chunks that follow one another without a gap, takes a shorter way: the
operators in a row behind a wire are written out as one function (`stream.engine.chain`), which is what `Wire.send` calls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from stream.chunk import Chunk, StreamSpec, add_lost
from stream.engine.chain import Chain
from stream.engine.link import Push
from stream.graph import Edge

Tap: TypeAlias = Callable[[Chunk], None]


class Wire:
    """One output of a node while a graph runs: carries `lost` to the next samples, keeps arrays normal, calls taps and readers.

    send     brings a chunk to all who read the wire; changed taps or readers of it, or of a wire behind it, need `loosen` before the next
    chain    the operators behind the wire as one function; None until something is sent
    """

    __slots__ = ("chain", "edge", "gaps", "lost", "owed", "readers", "samples", "send", "spec", "taps")

    def __init__(self, edge: Edge, spec: StreamSpec) -> None:
        self.edge, self.spec = edge, spec
        self.taps: list[Tap] = []
        self.readers: list[Push] = []
        self.owed = 0
        self.gaps = 0
        self.lost = 0
        self.samples = 0
        self.loosen()

    def loosen(self) -> None:
        """Forget the chain: the next chunk writes it anew."""
        self.chain: Chain | None = None
        self.send: Push = self._first

    def fasten(self, *, rows: bool = True) -> None:
        """Write the chain, so that the first chunk need not; `rows`: with what may have to be compiled."""
        self.chain = Chain(self, rows=rows)
        self.send = self.chain.send

    def _first(self, chunk: Chunk, start: int) -> int:
        """Only what is unusual comes upon a wire within a chain: for that, nothing is compiled while a graph runs."""
        if not self.chain:
            self.fasten(rows=False)
        return self.send(chunk, start)

    def carry(self, chunk: Chunk, start: int) -> int:
        """What `send` does, for a chunk of any kind."""
        if chunk.lost or self.owed:
            chunk = self._with_lost(chunk)
        self.samples += len(chunk.time)
        if not (chunk.data.flags.carray and chunk.time.flags.carray):
            chunk = _normal(chunk)
        for tap in self.taps:
            tap(chunk)
        for push in self.readers:
            start = push(chunk, start)
        return start

    def _with_lost(self, chunk: Chunk) -> Chunk:
        """Move a `lost` without samples to the next chunk that has some."""
        lost = add_lost(self.owed, chunk.lost)
        if not len(chunk.time):
            self.owed = lost
            return Chunk(chunk.time, chunk.data, chunk.until, 0)
        self.owed = 0
        self.gaps += 1
        self.lost = add_lost(self.lost, lost)
        return Chunk(chunk.time, chunk.data, chunk.until, lost)


def _normal(chunk: Chunk) -> Chunk:
    """The chunk with arrays that are contiguous, aligned and writable."""
    time, data = (np.require(array, requirements=["C", "A", "W"]) for array in (chunk.time, chunk.data))
    return Chunk(time, data, chunk.until, chunk.lost)
