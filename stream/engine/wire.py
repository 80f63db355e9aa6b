"""Between operators: a wire carries the chunks of one output to all who read it.

`Wire.carry` does so for chunks of any kind. What comes most, chunks that follow one another without a gap, takes a shorter way: the
operators in a row behind a wire are written out as one function (`stream.engine.chain`), which is what `Wire.send` calls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from stream.chunk import FOREVER, NEVER, Chunk, StreamSpec, add_lost
from stream.engine.chain import Chain
from stream.engine.link import Hand, Push
from stream.engine.promise import PromiseError, broken, ends
from stream.graph import Edge

Tap: TypeAlias = Callable[[Chunk], None]


class Wire:
    """One output of a node while a graph runs: checks what it promises, carries `lost` to the next samples, keeps arrays normal, calls taps
    and readers.

    told     its watermark: the `until` of the newest chunk
    checked  whether a node that may break its promise feeds it; a source's chunks have been looked at where they entered
    strict   whether the ends of stamps are checked, too, whoever listens
    hand     of the thread of the node that feeds it
    reached  how far that node's inputs are
    send     brings a chunk to all who read the wire; changed taps or readers of it, or of a wire behind it, need `loosen` before the next
    chain    the operators behind the wire as one function; None until something is sent
    """

    __slots__ = (
        "chain",
        "checked",
        "edge",
        "gaps",
        "hand",
        "hand",
        "lost",
        "owed",
        "reached",
        "readers",
        "samples",
        "send",
        "spec",
        "strict",
        "taps",
        "told",
    )

    def __init__(
        self, edge: Edge, spec: StreamSpec, hand: Hand | None = None, reached: Callable[[], int] = lambda: FOREVER
    ) -> None:
        """`hand` and `reached` of what a node feeds; None: what comes has been looked at."""
        self.edge, self.spec = edge, spec
        self.taps: list[Tap] = []
        self.readers: list[Push] = []
        self.owed = 0
        self.gaps = 0
        self.lost = 0
        self.samples = 0
        self.told = NEVER
        self.checked, self.hand = hand is not None, hand
        self.strict = False
        self.reached = reached
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

    @property
    def looks_at_ends(self) -> bool:
        """Whether the ends of stamps are checked: at the recorder, at outlets and behind operators from outside."""
        return self.checked and (self.strict or bool(self.taps))

    def check(self, chunk: Chunk) -> None:
        """Raise PromiseError where the node gave what its spec, its watermark or its inputs rule out."""
        if self.checked:
            what = broken(self.spec, chunk, self.told)
            if not what and self.looks_at_ends:
                what = ends(chunk, self.told, self.reached())
            if what:
                raise PromiseError(self.edge.node, self.edge.output, what, chunk)
        self.told = max(self.told, int(chunk.until))

    def carry(self, chunk: Chunk, start: int) -> int:
        """What `send` does, for a chunk of any kind."""
        self.check(chunk)
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
