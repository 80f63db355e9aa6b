"""A bounded queue of chunks before a thread, with a declared policy; every drop is counted and marked in the next chunk.

Many queues share one ready queue, the only thing their thread waits on: for every chunk that waits it holds the queue to look into. What a
queue dropped live is recorded, and repeated by `Drops`, so that replay is what was live.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Any, TypeAlias

import numpy as np

from kinegraph.stream.chunk import NEVER, Chunk, add_lost
from kinegraph.stream.engine.flow.admission import join, joins
from kinegraph.stream.graph.backpressure import MIN_CHUNKS, POLICIES, Policy

ReadyQueue: TypeAlias = "SimpleQueue[BoundedQueue | threading.Event | None]"
"""Holds queues that have a chunk, events to set when everything before them is done, and None to wake the thread."""

MAX_TOGETHER = 256
"""The most chunks that enter as one."""


class BoundedQueue:
    """What waits between the thread that writes and the thread that reads.

    name      what is waiting, for people: "board.emg", or "camera -> blocks"
    limit     how many chunks may wait
    bound     how many bytes may wait, where more than `MIN_CHUNKS` do; 0: no matter how many
    policy    what a full queue does (`stream.graph.backpressure`)
    on_drop   called with (first, n) of every drop: the dropped samples' running index in this queue and their number
    waiting   what waits: chunks, their arrivals, and the running index of their first samples
    gathered  what came after that, which its writer keeps for a moment to take it on together: chunks, and when they came
    pending_gap how many samples were dropped before the next chunk that is taken
    arrival_of  makes an arrival of when a gathered chunk came (ns of the host's monotonic clock)
    index     how many samples have come by, ever
    chunks    and in how many chunks
    promised  the watermark of what has been taken
    """

    __slots__ = (
        "_came_bytes",
        "_gone_bytes",
        "_lock",
        "_room",
        "arrival_of",
        "bound",
        "chunks",
        "closed",
        "dropped",
        "gathered",
        "index",
        "limit",
        "name",
        "on_drop",
        "owner",
        "pending_gap",
        "policy",
        "promised",
        "ready",
        "waiting",
    )

    def __init__(
        self,
        name: str,
        ready: ReadyQueue,
        limit: int,
        policy: Policy,
        on_drop: Callable[[int, int], None] | None = None,
        bound: int = 0,
    ) -> None:
        self.name, self.ready, self.limit, self.policy, self.on_drop = name, ready, limit, policy, on_drop
        self.bound = bound
        self._came_bytes = self._gone_bytes = 0
        self.owner: Any = None
        self.arrival_of: Callable[[int], int] = int
        self.dropped = 0
        self.closed = False
        self.chunks = self.index = 0
        self.waiting: deque[tuple[Chunk, int, int]] = deque()
        self.gathered: deque[tuple[Chunk, int]] = deque()
        self.pending_gap = 0
        self.promised = NEVER
        self._lock = threading.Lock()
        self._room = threading.Event()

    def put(self, chunk: Chunk, arrival: int = 0) -> None:
        """Leave a chunk, behind what is gathered; waits, drops or fails as the policy says where the queue is full."""
        if self.gathered:
            self.leave_gathered()
        # asked without the lock: one thread writes, and what is taken meanwhile only makes room
        if self.full and POLICIES[self.policy](self, chunk, arrival):
            return
        self._leave(chunk, arrival)

    def leave_gathered(self) -> None:
        """What is gathered waits like any other chunk from now on."""
        with self._lock:
            while self.gathered:
                earlier, came = self.gathered.popleft()
                self._leave(earlier, self.arrival_of(came))

    @property
    def full(self) -> bool:
        """Whether no further chunk may wait."""
        n = len(self.waiting)
        return n >= self.limit or (n >= MIN_CHUNKS and 0 < self.bound <= self._came_bytes - self._gone_bytes)

    def _leave(self, chunk: Chunk, arrival: int) -> None:
        self._came_bytes += chunk.data.nbytes
        self.waiting.append((chunk, arrival, self.index))  # one thread writes, so this needs no lock
        self.index += len(chunk.time)
        self.chunks += 1
        self.ready.put(self)

    def take_together(self) -> Iterator[tuple[Chunk, int, bool]]:
        """All that waits and is gathered now, in its order, each with its arrival: what may enter together (`admission.joins`) as one, and
        whether it is."""
        together: list[Chunk] = []
        arrival = until = 0
        for chunk, at in self._take_all():
            if together and (len(together) == MAX_TOGETHER or not joins(until, chunk)):
                yield join(together), arrival, len(together) > 1
                together = []
            together.append(chunk)
            arrival, until = at, chunk.until
        if together:
            yield join(together), arrival, len(together) > 1

    def _take_all(self) -> list[tuple[Chunk, int]]:
        items = []
        while (item := self.take()) is not None:
            items.append(item)
        with self._lock:  # so that its writer cannot move them into the queue meanwhile; what it gathers later waits for the next call
            if self.waiting or not self.gathered:
                return items
            take = self.gathered.popleft
            gathered = [take() for _ in range(len(self.gathered))]
        offset = self.arrival_of(gathered[0][1]) - gathered[0][1]
        return items + [(chunk, came + offset) for chunk, came in gathered]

    def take(self) -> tuple[Chunk, int] | None:
        """The oldest chunk and its arrival, with the drops before it added to its `lost`; None where nothing waits."""
        with self._lock:
            if not self.waiting:
                return None
            chunk, arrival, _ = self.waiting.popleft()
            self._gone_bytes += chunk.data.nbytes
            if self.pending_gap:
                chunk = Chunk(chunk.time, chunk.data, chunk.until, add_lost(self.pending_gap, chunk.lost))
                self.pending_gap = 0
        if not self._room.is_set():
            self._room.set()
        self.promised = chunk.until
        return chunk, arrival

    def close(self) -> None:
        """Let a blocked writer go; what it puts from now on waits without limit."""
        self.closed = True
        self._room.set()

    @property
    def depth(self) -> int:
        """How many chunks wait now."""
        return len(self.waiting) + len(self.gathered)

    def wait_for_room(self) -> None:
        """Hold up the writer until there is room, or the queue is closed."""
        while self.full and not self.closed:
            # asked again after `clear`: a reader may have made room between the two, and its `set` is gone
            self._room.clear()
            if self.full:
                self._room.wait(0.5)

    def replace_oldest(self, chunk: Chunk, arrival: int) -> bool:
        """Drop the oldest for this one, which needs no further entry: so a ready queue never holds more than what waits, however long its
        thread is behind. False where there is room by now."""
        with self._lock:
            if len(self.waiting) < self.limit:
                return False
            oldest, _, index = self.waiting.popleft()
            self.waiting.append((chunk, arrival, self.index))
            self._gone_bytes += oldest.data.nbytes
            self._came_bytes += chunk.data.nbytes
            self.index += len(chunk.time)
            self.chunks += 1
            n = len(oldest.time)
            self.pending_gap = add_lost(self.pending_gap, add_lost(oldest.lost, n))
            self.dropped += n
        if n and self.on_drop:
            self.on_drop(index, n)
        return True


DROPPED = "queue dropped"
"""The kind of log entry that says so; its facts are `queue`, `first` (running index of the first sample) and `samples`."""


@dataclass(slots=True)
class Drops:
    """What was dropped before one worker: ranges of the running sample index, how far the stream has come, and how many samples were left
    out since the last that was not."""

    ranges: list[tuple[int, int]] = field(default_factory=list)
    index: int = 0
    pending_gap: int = 0

    def repeat(self, chunk: Chunk) -> Chunk:
        """The chunk without the samples that were dropped, which are added to the next sample's `lost`."""
        n = len(chunk.time)
        first, self.index = self.index, self.index + n
        if not self.ranges and not self.pending_gap:
            return chunk
        gone = np.zeros(n, bool)
        for start, count in self.ranges:
            gone[max(0, start - first) : max(0, start + count - first)] = True
        self.ranges = [(s, c) for s, c in self.ranges if s + c > self.index]
        if not gone.any():
            return self._marked(chunk)
        self.pending_gap = add_lost(self.pending_gap, add_lost(chunk.lost, int(gone.sum())))
        return self._marked(Chunk(chunk.time[~gone], chunk.data[~gone], chunk.until, 0))

    def _marked(self, chunk: Chunk) -> Chunk:
        if not self.pending_gap or not len(chunk.time):
            return chunk
        lost, self.pending_gap = add_lost(self.pending_gap, chunk.lost), 0
        return Chunk(chunk.time, chunk.data, chunk.until, lost)


def recorded_drops(log: Iterable[dict[str, Any]]) -> dict[str, Drops]:
    """Per queue, what a session's log says was dropped."""
    drops: dict[str, Drops] = {}
    for entry in log:
        if entry.get("kind") == DROPPED:
            drops.setdefault(entry["queue"], Drops()).ranges.append((entry["first"], entry["samples"]))
    return drops
