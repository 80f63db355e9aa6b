"""A bounded queue of chunks before a thread, with a declared policy; every drop is counted and marked in the next chunk.

Many channels share one doorbell, the only thing their thread waits on: it rings once per chunk that waits, with the
channel to look into.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeAlias

from stream.chunk import NEVER, Chunk, add_lost
from stream.errors import RunError
from stream.graph import Policy

Doorbell: TypeAlias = "SimpleQueue[Channel | threading.Event | None]"
"""Rings with the channel that has a chunk, with an event to set when everything before it is done, or with None to wake the thread."""


class Channel:
    """What waits between the thread that writes and the thread that reads.

    name      what is waiting, for people: "board.emg", or "camera -> blocks"
    limit     how many chunks may wait
    policy    what a full queue does: `block` its writer, `drop_oldest`, or `fail`
    on_drop   told (first, n) of every drop: the dropped samples' running index in this channel and their number
    waiting   what waits: chunks, their arrivals, and the running index of their first samples
    owed      how many samples were dropped before the next chunk that is taken
    index     how many samples have come by, ever
    chunks    and in how many chunks
    told      the watermark of what has been taken
    """

    __slots__ = (
        "_lock",
        "_room",
        "bell",
        "chunks",
        "closed",
        "dropped",
        "index",
        "limit",
        "name",
        "on_drop",
        "owed",
        "owner",
        "policy",
        "told",
        "waiting",
    )

    def __init__(
        self, name: str, bell: Doorbell, limit: int, policy: Policy, on_drop: Callable[[int, int], None] | None = None
    ) -> None:
        self.name, self.bell, self.limit, self.policy, self.on_drop = name, bell, limit, policy, on_drop
        self.owner: Any = None
        self.dropped = 0
        self.closed = False
        self.chunks = self.index = 0
        self.waiting: deque[tuple[Chunk, int, int]] = deque()
        self.owed = 0
        self.told = NEVER
        self._lock = threading.Lock()
        self._room = threading.Event()

    def put(self, chunk: Chunk, arrival: int = 0) -> None:
        """Leave a chunk; waits, drops or fails as the policy says where the queue is full."""
        if len(self.waiting) >= self.limit and self._is_in_place_of_another(chunk, arrival):
            return
        self.waiting.append((chunk, arrival, self.index))  # one thread writes, so this needs no lock
        self.index += len(chunk.time)
        self.chunks += 1
        self.bell.put(self)

    def take(self) -> tuple[Chunk, int] | None:
        """The oldest chunk and its arrival, with the drops before it added to its `lost`; None where nothing waits."""
        with self._lock:
            if not self.waiting:
                return None
            chunk, arrival, _ = self.waiting.popleft()
            if self.owed:
                chunk = Chunk(chunk.time, chunk.data, chunk.until, add_lost(self.owed, chunk.lost))
                self.owed = 0
        if not self._room.is_set():
            self._room.set()
        self.told = chunk.until
        return chunk, arrival

    def close(self) -> None:
        """Let a blocked writer go; what it puts from now on waits without limit."""
        self.closed = True
        self._room.set()

    @property
    def depth(self) -> int:
        """How many chunks wait now."""
        return len(self.waiting)

    def _is_in_place_of_another(self, chunk: Chunk, arrival: int) -> bool:
        """What the policy says of a full queue; whether the chunk waits now, in the place of an older one that was dropped for it."""
        if self.policy == "fail":
            raise RunError(f"the queue of {self.name} is full ({self.limit} chunks) and its policy is 'fail'")
        if self.policy == "drop_oldest":
            return not self.closed and self._replace(chunk, arrival)
        while len(self.waiting) >= self.limit and not self.closed:
            self._room.clear()
            if len(self.waiting) >= self.limit:
                self._room.wait(0.5)
        return False

    def _replace(self, chunk: Chunk, arrival: int) -> bool:
        """Drop the oldest for this one, which needs no further ring: so a bell never holds more than what waits, however long its
        thread is behind. False where there is room by now."""
        with self._lock:
            if len(self.waiting) < self.limit:
                return False
            oldest, _, index = self.waiting.popleft()
            self.waiting.append((chunk, arrival, self.index))
            self.index += len(chunk.time)
            self.chunks += 1
            n = len(oldest.time)
            self.owed = add_lost(self.owed, add_lost(oldest.lost, n))
            self.dropped += n
        if n and self.on_drop:
            self.on_drop(index, n)
        return True
