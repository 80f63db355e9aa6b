"""What a node promises about its outputs, and the error where it breaks a promise.

Shape, dtype and watermark of every new chunk are checked while a graph runs, where a chunk enters an edge; the ends of its stamps where
the recorder or an outlet reads the edge, or an operator from outside our packages feeds it. What is common is checked in the code of
segments (`stream.engine.flow.segment`); whatever fails there comes here to be named. Stamps within a chunk are looked at by the
laws, and by a replay that is asked to.
"""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, StreamSpec, utc
from kinegraph.stream.errors import RunError

END = 2**62
"""Stamps of samples lie before this time (the year 2116) and after its negative."""
MAX_LOST = 2**48
"""No source has lost more samples than these."""


SLACK_NS = NS
"""A sample may be so far ahead of its inputs' watermarks, which may be behind their samples."""


class PromiseError(RunError):
    """A node, or a source, gave a chunk that it had promised not to give."""

    def __init__(self, node: str, output: str, what: str, chunk: Chunk, kind: str = "node") -> None:
        super().__init__(f"{kind} {node!r}, output {output!r}: gave {what}{_at(chunk)}")


def broken(spec: StreamSpec, chunk: Chunk, promised: int) -> str:
    """What is wrong with the shape, dtype or watermark of a chunk; "" if nothing. `promised` is the watermark so far."""
    time, data, until = chunk.time, chunk.data, chunk.until
    if not isinstance(time, np.ndarray) or time.dtype != np.int64 or time.ndim != 1:
        return f"{_kind(time)} stamps; stamps are (n,) int64"
    if not isinstance(data, np.ndarray) or data.dtype != spec.dtype or data.shape != (len(time), *spec.shape):
        return (
            f"{_kind(data)} samples for {len(time)} stamps; its spec promises {(len(time), *spec.shape)} {spec.dtype}"
        )
    for name in ("until", "lost"):
        value = getattr(chunk, name)
        if not isinstance(value, int | np.integer) or isinstance(value, bool):
            return f"{name}={value!r}, which is no whole number"
    if chunk.lost < -1:
        return f"lost={chunk.lost}; it must be -1 (unknown) or more"
    if until < promised:
        return f"the watermark {utc(int(until))}, after {utc(promised)}; a watermark never goes back"
    return ""


def ends(chunk: Chunk, promised: int, reached: int) -> str:
    """What is wrong with a chunk's first and last stamp; `reached` is how far the node's inputs are."""
    if not len(chunk.time):
        return ""
    first, last = chunk.time.item(0), chunk.time.item(-1)
    if last < first:
        return f"stamps that run backwards, to {utc(last)}"
    if first <= promised:
        return f"a sample behind its watermark, {utc(promised)}"
    if last > reached + SLACK_NS:
        return f"a sample at {utc(last)}, ahead of its inputs, which are no further than {utc(reached)}"
    return ""


def impossible(chunk: Chunk) -> str:
    """What is wrong with the times that a source gave, whatever its device says; "" if nothing."""
    if len(chunk.time) and not (chunk.time.min() > -END and chunk.time.max() < END):
        return f"stamps up to {max(int(chunk.time.max()), -int(chunk.time.min()))}; nanoseconds since 1970 are less than 2^62"
    if not -END < chunk.until < END:
        return f"until={chunk.until}; nanoseconds since 1970 are less than 2^62"
    if not -1 <= chunk.lost <= MAX_LOST:
        return f"lost={chunk.lost}; it must be -1 (unknown), or a number of samples"
    return ""


def _kind(array: object) -> str:
    return f"{array.shape} {array.dtype}" if isinstance(array, np.ndarray) else type(array).__name__


def _at(chunk: Chunk) -> str:
    """The sample time of a chunk, for the end of a sentence."""
    time: Array | object = chunk.time
    if isinstance(time, np.ndarray) and time.ndim == 1 and len(time):
        return f" (at sample time {utc(int(time[0]))})"
    return f" (at sample time {utc(chunk.until)})" if isinstance(chunk.until, int) else ""


class Inside:
    """Looks into every chunk that passes an observed edge, in a replay that is asked to: too dear for a live graph.

    broken   what broke the promise first, and where; "" while nothing did
    """

    def __init__(self) -> None:
        self._last = NEVER
        self.broken = ""

    def look(self, chunk: Chunk) -> None:
        """Whether stamps never decrease."""
        time = chunk.time
        if len(time) and not self.broken:
            if int(time[0]) < self._last or (time[1:] < time[:-1]).any():
                self.broken = f"stamps that run backwards in the chunk at {utc(int(time[0]))}"
            self._last = int(time[-1])
