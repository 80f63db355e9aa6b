"""The bounded channel from a session to its page: what is not taken in time is dropped and marked; samples never wait."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from threading import Lock
from typing import NamedTuple, TypeAlias

from kinegraph.devices.page.transfer.pipe import PipeMessage, ServerPipe
from kinegraph.devices.page.transfer.wire import encode
from kinegraph.stream.chunk import Chunk

MAX_BYTES = 32 << 20
TICK_S = 1 / 30
"""What comes within this time is handed over together."""
UNSEEN_TICK_S = 0.25
"""Without viewers."""
TICK = encode({"t": "tick"})


class Portion(NamedTuple):
    """Chunks of one stream that follow one another.

    lost   before the first of them
    """

    stream: int
    chunks: list[Chunk]
    lost: int


Taken: TypeAlias = "Portion | bytes"


class PageChannel:
    """Chunks of numbered streams on their way to the page. What puts them in may be called from any thread and never waits for a reader.

    Whoever puts a chunk in hands over, some 30 times a second, what has come together: no thread is woken for it. What is left, and
    pictures, are handed over by the lane's thread.

    wanted    per stream, whether somebody looks at it
    newest    per stream, whether only its newest sample matters (a picture)
    seen      whether anybody looks
    dropped   chunks that were too many
    """

    def __init__(self, newest: list[bool], max_bytes: int = MAX_BYTES) -> None:
        self.newest, self.wanted = newest, [False] * len(newest)
        self.seen = False
        self.dropped = 0
        self._most, self._held = max_bytes, 0
        self._queue: deque[tuple[int, Chunk] | bytes] = deque()
        self._last: dict[int, Chunk] = {}
        self._torn: set[int] = set()
        self._lock, self._handing = Lock(), Lock()
        self._pipe: ServerPipe | None = None
        self._due_s = 0.0

    @property
    def pictures_wanted(self) -> bool:
        """Whether somebody looks at a picture."""
        return any(newest and wanted for newest, wanted in zip(self.newest, self.wanted, strict=True))

    def observer(self, number: int) -> Callable[[Chunk], None]:
        """What puts a stream's chunks in; takes well under a microsecond without viewers."""
        wanted, last = self.wanted, self._last
        if self.newest[number]:

            def keep(chunk: Chunk) -> None:
                if wanted[number] and len(chunk.time):
                    last[number] = chunk

            return keep

        def put(chunk: Chunk) -> None:
            if wanted[number] and len(chunk.time):
                self._put(number, chunk)
                if time.monotonic() >= self._due_s:
                    self.hand_over(wait=False)

        return put

    def _put(self, number: int, chunk: Chunk) -> None:
        with self._lock:
            self._queue.append((number, chunk))
            self._held += chunk.data.nbytes
            while self._held > self._most:
                self._drop()

    def _drop(self) -> None:
        place, oldest = next((i, w) for i, w in enumerate(self._queue) if not isinstance(w, bytes))
        del self._queue[place]
        self._held -= oldest[1].data.nbytes
        self._torn.add(oldest[0])
        self.dropped += 1

    def announce(self, *messages: bytes) -> None:
        """Messages that stand between what was put in before them and what comes after."""
        with self._lock:
            self._queue += messages

    def forget(self) -> None:
        """What waits is of no use any more."""
        with self._lock:
            self._queue.clear()
            self._last.clear()
            self._torn.clear()
            self._held = 0

    def take(self) -> list[Taken]:
        """All that waits, the chunks of a stream together up to a gap; where some were dropped before it, its `lost` says so."""
        with self._lock:
            queue, self._queue, self._held = self._queue, deque(), 0
            torn, self._torn = self._torn, set()
        taken = _together(queue)
        for i, part in enumerate(taken):
            if isinstance(part, Portion) and part.stream in torn:
                torn.discard(part.stream)
                taken[i] = part._replace(lost=-1)
        return taken

    def pictures(self) -> list[Portion]:
        """The newest sample of each stream of pictures that has a new one."""
        chunks = [(number, self._last.pop(number)) for number in [*self._last]]
        return [Portion(number, [Chunk(c.time[-1:], c.data[-1:], c.until)], 0) for number, c in chunks]

    # to the server ---------------------------------------------------------------------------------------------------

    def lead_to(self, pipe: ServerPipe | None) -> None:
        """Hand over to this one from now on; None: stop."""
        with self._handing:
            self._pipe = pipe
            if not pipe:
                self.wanted[:], self.seen = [False] * len(self.wanted), False

    @property
    def is_left(self) -> bool:
        """Whether all is left to the lane's thread, as the pipe may wait."""
        return self._pipe is not None and self._pipe.waits

    @property
    def is_led(self) -> bool:
        """Whether there is a server that reads."""
        return self._pipe is not None

    def hand_over(self, *more: PipeMessage, wait: bool = True) -> bool:
        """What waits, and then further messages, in one go; False without room, or where another thread is at it and is not waited for."""
        if (not wait and self.is_left) or not self._handing.acquire(blocking=wait):
            return False
        try:
            self._due_s = time.monotonic() + (TICK_S if self.seen else UNSEEN_TICK_S)
            return self._pipe is not None and self._write(self._pipe, more)
        except OSError:  # the server has ended; the lane's thread starts another
            self._pipe = None
            return False
        finally:
            self._handing.release()

    def _write(self, pipe: ServerPipe, more: tuple[PipeMessage, ...]) -> bool:
        if not pipe.flush():
            return False
        messages = [[part] if isinstance(part, bytes) else message(part) for part in self.take()]
        if messages or more:
            pipe.write([*messages, *more, [TICK]])
        return True


def message(part: Portion) -> PipeMessage:
    """Chunks, for the server's process: all stamps, then all samples."""
    stream, chunks, lost = part
    n = sum(len(chunk.time) for chunk in chunks)
    header = {"t": "chunk", "s": stream, "n": n, "lost": int(lost), "until": int(chunks[-1].until)}
    return [encode(header), *(chunk.time for chunk in chunks), *(chunk.data for chunk in chunks)]


def _together(queue: deque[tuple[int, Chunk] | bytes]) -> list[Taken]:
    """The chunks of each stream as one, up to a gap or to what was announced."""
    found: dict[int, Portion] = {}
    taken: list[Taken] = []
    for waiting in queue:
        if isinstance(waiting, bytes):
            taken += [*found.values(), waiting]
            found.clear()
            continue
        number, chunk = waiting
        if number in found and not chunk.lost:
            found[number].chunks.append(chunk)
            continue
        if number in found:
            taken.append(found.pop(number))
        found[number] = Portion(number, [chunk], chunk.lost)
    return [*taken, *found.values()]
