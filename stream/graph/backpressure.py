"""Backpressure: what happens to a chunk that comes to a full queue. Every policy is here, a function and its name; what graphs may say, its
check and its messages follow from these."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol, TypeAlias

from kinegraph.stream.chunk import Chunk
from kinegraph.stream.errors import RunError

Policy = Literal["block", "drop_oldest", "fail"]
"""What a graph may say."""


class FullQueue(Protocol):
    """What a policy may do with the queue before which it stands.

    closed   its readers have gone: writers do not wait, and nothing is dropped
    """

    name: str
    limit: int
    closed: bool

    def wait_for_room(self) -> None:
        """Hold up the writer until there is room, or the queue is closed."""

    def replace_oldest(self, chunk: Chunk, arrival: int) -> bool:
        """Drop the oldest chunk for this one, counted and marked in the next that is taken; False where there is room by now."""


LIVE_BYTES, OTHER_BYTES, MIN_CHUNKS = 16 << 20, 4 << 20, 8
"""A queue of policy `block` is full at this size, in sessions with live sources and in others, once it has that many chunks: 256 images
take more memory than all that works on them. Nothing is lost by waiting; a queue that drops or fails has its count of chunks alone."""


def max_bytes(policy: Policy, *, live: bool) -> int:
    """The bytes at which a queue of this policy is full; 0: only its chunks are counted."""
    if policy != "block":
        return 0
    return LIVE_BYTES if live else OTHER_BYTES


def queued_bytes(chunks: int, chunk_bytes: int, bound: int) -> int:
    """The most that a queue for this number of chunks, each of this size, can hold with a bound by `max_bytes`."""
    return chunks * chunk_bytes if not bound else min(chunks * chunk_bytes, max(bound, MIN_CHUNKS * chunk_bytes))


OnFull: TypeAlias = Callable[[FullQueue, Chunk, int], bool]
"""Called with a chunk and its arrival; returns whether the chunk replaces a waiting one. If not, it waits behind the others."""


def block(queue: FullQueue, chunk: Chunk, arrival: int) -> bool:
    queue.wait_for_room()
    return False


def drop_oldest(queue: FullQueue, chunk: Chunk, arrival: int) -> bool:
    return not queue.closed and queue.replace_oldest(chunk, arrival)


def fail(queue: FullQueue, chunk: Chunk, arrival: int) -> bool:
    raise RunError(f"the queue of {queue.name} is full ({queue.limit} chunks) and its policy is 'fail'")


POLICIES: dict[Policy, OnFull] = {"block": block, "drop_oldest": drop_oldest, "fail": fail}
