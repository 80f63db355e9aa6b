"""The bounded channel from a session to its page: what nobody takes in time is dropped, and the stream says so; samples never wait."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Lock

import numpy as np

from stream.chunk import Chunk

MOST_BYTES = 32 << 20


class PageChannel:
    """Chunks of numbered streams on their way to the page. `put` may be called from any thread and never waits for a reader.

    wanted    per stream, whether somebody looks at it
    newest    per stream, whether only its newest sample matters (a picture)
    dropped   chunks that were too many
    """

    def __init__(self, newest: list[bool], most_bytes: int = MOST_BYTES) -> None:
        self.newest, self.wanted = newest, [False] * len(newest)
        self.dropped = 0
        self._most, self._held = most_bytes, 0
        self._queue: deque[tuple[int, Chunk]] = deque()
        self._last: dict[int, Chunk] = {}
        self._torn: set[int] = set()
        self._lock = Lock()

    def observer(self, number: int) -> Callable[[Chunk], None]:
        """What puts a stream's chunks in; takes well under a microsecond where nobody looks."""
        wanted, last = self.wanted, self._last
        if self.newest[number]:

            def keep(chunk: Chunk) -> None:
                if wanted[number] and len(chunk.time):
                    last[number] = chunk

            return keep

        def put(chunk: Chunk) -> None:
            if wanted[number] and len(chunk.time):
                self._put(number, chunk)

        return put

    def _put(self, number: int, chunk: Chunk) -> None:
        with self._lock:
            self._queue.append((number, chunk))
            self._held += chunk.data.nbytes
            while self._held > self._most:
                late, old = self._queue.popleft()
                self._held -= old.data.nbytes
                self._torn.add(late)
                self.dropped += 1

    def take(self) -> list[tuple[int, Chunk]]:
        """All that waits, the chunks of a stream joined to one; where some were dropped before it, its `lost` says so."""
        with self._lock:
            queue, self._queue, self._held = self._queue, deque(), 0
            torn, self._torn = self._torn, set()
        found: dict[int, list[Chunk]] = {}
        taken: list[tuple[int, Chunk]] = []
        for number, chunk in queue:
            if chunk.lost and number in found:
                taken.append((number, _joined(found.pop(number))))
            found.setdefault(number, []).append(chunk)
        taken += [(number, _joined(chunks)) for number, chunks in found.items()]
        for number in torn:
            for i, (stream, chunk) in enumerate(taken):
                if stream == number:
                    taken[i] = stream, Chunk(chunk.time, chunk.data, chunk.until, -1)
                    break
        for number in [*self._last]:
            chunk = self._last.pop(number)
            taken.append((number, Chunk(chunk.time[-1:], chunk.data[-1:], chunk.until)))
        return taken


def _joined(chunks: list[Chunk]) -> Chunk:
    if len(chunks) == 1:
        return chunks[0]
    time, data = np.concatenate([c.time for c in chunks]), np.concatenate([c.data for c in chunks])
    return Chunk(time, data, chunks[-1].until, chunks[0].lost)
