"""Whether a node keeps, on a whole recording, what its `open` promised: too dear for a live graph, so a replay looks when asked."""

from __future__ import annotations

from stream.chunk import NEVER, Chunk, utc
from stream.engine.wire import Wire


class Promise:
    """Looks at every chunk of a wire, until one breaks the promise of its spec or of an earlier `until`.

    broken   what broke it first, and where; "" while nothing did
    """

    def __init__(self, wire: Wire) -> None:
        self._spec, self._until = wire.spec, NEVER
        self.broken = ""
        wire.taps.append(self._look)

    def _look(self, chunk: Chunk) -> None:
        if not self.broken:
            self.broken = self._what(chunk)
            self._until = max(self._until, chunk.until)

    def _what(self, chunk: Chunk) -> str:
        time, data, spec = chunk.time, chunk.data, self._spec
        at = f" at {utc(int(time[0]))}" if len(time) else ""
        if data.dtype != spec.dtype or data.shape != (len(time), *spec.shape):
            return f"samples {data.shape} {data.dtype}{at}; its spec says {(len(time), *spec.shape)} {spec.dtype}"
        if len(time) > 1 and (time[1:] < time[:-1]).any():
            return f"stamps that run backwards in the chunk{at}"
        if len(time) and time[0] <= self._until:
            return f"a sample{at}, after it had said that all up to {utc(self._until)} was told"
        return ""
