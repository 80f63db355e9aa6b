"""A stream on its way to the recorder's thread, and what is told of the recording from outside."""

from __future__ import annotations

from dataclasses import dataclass, field

from stream.chunk import StreamSpec
from stream.recording.format import Kept, Logged
from stream.recording.packed import Packer

STREAMS = 2
"""The number of the first stream's lane, after those of the log and the metrics."""
OVERHEAD = 400
"""Bytes that a waiting chunk takes beside its samples."""


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """How recording goes.

    bytes      written to the disk, all parts together
    behind_s   session time between the newest chunk handed over and the newest one written
    dropped    chunks that were not recorded because the disk was slow or full, by stream
    error      what the disk last said, while it refuses; "" when all is well
    """

    bytes: int
    behind_s: float
    dropped: dict[str, int]
    error: str


@dataclass(slots=True)
class RecorderSlot:
    """A stream (or the log, or the metrics) on its way to the recorder's thread. Each counter has one thread that writes it.

    put, dropped, missed   of the stream's thread: bytes handed over; chunks dropped; samples dropped since the last chunk accepted
    got, index, refused    of the recorder's thread: bytes taken; index of the next sample; chunks that were not of the stream's spec
    pending, first         of the recorder's thread: the chunks of the next message, and the index of their first sample
    kept                   how its samples are kept
    copied                 whether chunks are copied when they are handed over: what sources gave, before any operator sees it
    track, frames          where on the tape its chunks go, and its frames if it has any
    packer                 packs its frames; None: they are kept as images, or not at all
    """

    name: str
    spec: StreamSpec | None = None
    put: int = 0
    dropped: int = 0
    refused: int = 0
    missed: int = 0
    got: int = 0
    index: int = 0
    pending: list[Logged] = field(default_factory=list)
    first: int = 0
    kept: Kept = "whole"
    copied: bool = False
    topic: int = 0
    frames: int = 0
    packer: Packer | None = None
