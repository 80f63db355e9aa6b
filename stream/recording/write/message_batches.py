"""Batches of messages: about 100 ms of all streams, handed to the recorder's thread together so that readers can sort them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Event, Lock

from kinegraph.stream.chunk import Chunk
from kinegraph.stream.recording.write.message_builder import MessageBuilder
from kinegraph.stream.recording.write.recorder_slot import RecorderSlot

ROUND_BYTES = 1 << 20
"""Beyond this many bytes of samples the gathering ends early."""


@dataclass(slots=True)
class MessageBatch:
    """What was gathered until `newest`, an arrival in ns: messages, each with its stream."""

    newest: int
    messages: list[tuple[RecorderSlot, MessageBuilder]] = field(default_factory=list)


class MessageBatches:
    """The round that is being gathered. Any thread may add to it, and end it.

    newest   the newest arrival so far (ns)
    oldest   the first one
    size     bytes that are gathered
    """

    def __init__(
        self, slots: Sequence[RecorderSlot], gather_ns: int, hand_over: Callable[[MessageBatch | Event], None]
    ) -> None:
        """`hand_over` takes each round that ends, one after the other, and the marks between them."""
        self._slots, self._gather_ns, self._hand_over = slots, gather_ns, hand_over
        self._lock = Lock()
        self._ended: list[tuple[RecorderSlot, MessageBuilder]] = []
        self._opened = self.size = 0
        self.newest = self.oldest = 0

    def add(
        self, slot: RecorderSlot, n: int, size: int, chunk: Chunk, arrival: int, sequence: int, *, owned: bool = False
    ) -> None:
        """Join a chunk of `n` samples, which takes `size` bytes, to its stream's message; raises ValueError or TypeError where it is not of
        its spec. Memory that is the session's own (`owned`) needs no copy."""
        with self._lock:
            if arrival > self.newest:
                self.oldest = self.oldest or arrival
                self.newest = arrival
            if not self.size:
                self._opened = self.newest
            elif self.newest - self._opened >= self._gather_ns or self.size > ROUND_BYTES:
                self._end()
                self._opened = self.newest
            gathering = slot.gathering
            if gathering is None or slot.missed:
                gathering = self._begun(slot)
            gathering.add(chunk, n, size, arrival, sequence, owned=owned)
            slot.put += size
            self.size += size

    def _begun(self, slot: RecorderSlot) -> MessageBuilder:
        """A new message of a stream, behind what the recorder has missed."""
        self._ended_with(slot)
        assert slot.spec is not None
        slot.index += slot.missed
        slot.missed = 0
        slot.gathering = MessageBuilder(slot.spec, slot.kept, slot.index, copied=slot.copied)
        return slot.gathering

    def _ended_with(self, slot: RecorderSlot) -> None:
        """A stream's message, if there is one, is whole."""
        if slot.gathering is not None:
            slot.index += slot.gathering.count
            self._ended.append((slot, slot.gathering))
            slot.gathering = None

    def end(self, mark: Event | None = None) -> None:
        """Hand over what has been gathered, then `mark`, and begin a new round; of what is added later, nothing comes before the mark."""
        with self._lock:
            if self.size:
                self._end()
            if mark is not None:
                self._hand_over(mark)

    def _end(self) -> None:
        for slot in self._slots:
            self._ended_with(slot)
        self._hand_over(MessageBatch(self.newest, [(slot, message) for slot, message in self._ended if message.chunks]))
        self._ended = []
        self.size = 0
