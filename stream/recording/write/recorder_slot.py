"""A stream on its way to the recorder's thread, and what is known of the recording from outside."""

from __future__ import annotations

from dataclasses import dataclass

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.recording.format.layout import Kept
from kinegraph.stream.recording.format.packed import Packer
from kinegraph.stream.recording.write.message_builder import MessageBuilder

STREAMS = 2
"""The number of the first stream's slot, after those of the log and the metrics."""
OVERHEAD = 400
"""Bytes that a waiting chunk, or a line of the log, is taken to need beside its samples."""


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """How recording goes.

    bytes      written to the disk, all parts together
    behind_s   session time between the newest chunk handed over and the newest one written
    dropped    chunks that were not recorded because the disk was slow or full, by stream
    error      the disk's last error, while it refuses; else ""
    missing    once it is closed: what is missing because somebody deleted, moved or cut its files
    """

    bytes: int
    behind_s: float
    dropped: dict[str, int]
    error: str
    missing: str = ""

    @property
    def shortfall(self) -> str:
        """What was handed over and is not in the recording, in words; "" where all of it is."""
        chunks = ", ".join(f"{n} chunks of {name}" for name, n in self.dropped.items())
        return "; ".join(filter(None, [chunks and f"not recorded: {chunks}", self.missing, self.error]))


@dataclass(slots=True)
class RecorderSlot:
    """A stream (or the log, or the metrics) on its way to the recorder's thread. Each counter has one thread that writes it.

    put, dropped, missed, index   of the stream's thread: bytes handed over; chunks dropped; samples dropped since the last chunk accepted;
                                  index of the next message's first sample
    refused                       also of the stream's thread: chunks that were not of the stream's spec
    got                           of the recorder's thread: bytes written
    gathering                     the message that is being gathered; None where nothing has come since the last
    kept                          how its samples are kept
    copied                        whether samples are copied when they are handed over: what sources gave, before any operator sees it
    topic, frames                 in the file: where its chunks go, and its frames if it has any
    packer                        packs its frames; None: they are kept as images, or not at all
    """

    name: str
    spec: StreamSpec | None = None
    put: int = 0
    dropped: int = 0
    refused: int = 0
    missed: int = 0
    got: int = 0
    index: int = 0
    gathering: MessageBuilder | None = None
    kept: Kept = "whole"
    copied: bool = False
    topic: int = 0
    frames: int = 0
    packer: Packer | None = None
