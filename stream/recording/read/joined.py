"""A recording's chunks, joined into longer ones: what a replay that goes as fast as it can works through.

Chunks carry no meaning (the first law), so a second's worth of a stream may come as one chunk. Gaps stay where they are.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from kinegraph.stream.chunk import NS, Chunk, StreamSpec, add_lost, empty
from kinegraph.stream.recording.format.layout import COLUMNS, HEAD
from kinegraph.stream.recording.read.reader import Recording

SPAN_NS = NS
"""About this much session time is joined."""
SPAN_BYTES = 8 << 20
"""More than this is not held to be joined."""
ROW = struct.Struct("<5q")
"""What a message says of one chunk: samples, until, lost, arrival, sequence."""


@dataclass(slots=True)
class _Heap:
    """The messages of one stream that wait to be joined.

    end      the recording's index of the sample after the last one, over all heaps of the stream
    missed   (chunks before it, samples): what a full disk cost
    pending_gap samples lost before the first one that comes
    last     sequence and `until` of the newest chunk that was taken
    """

    spec: StreamSpec
    end: int | None = None
    rows: list[memoryview] = field(default_factory=list)
    times: list[memoryview] = field(default_factory=list)
    data: list[memoryview] = field(default_factory=list)
    missed: list[tuple[int, int]] = field(default_factory=list)
    chunks: int = 0
    first_sequence: int = 0
    arrival: int = 0
    pending_gap: int = 0
    last: tuple[int, int] = (0, 0)

    def add(self, body: memoryview) -> int:
        """Take a message; returns its bytes."""
        chunks, samples, first = HEAD.unpack_from(body)
        table = HEAD.size + ROW.size * chunks
        stamps = table + 8 * samples
        if not self.rows:
            self.first_sequence = ROW.unpack_from(body, HEAD.size)[4]
        if self.end is not None and first > self.end:
            self.missed.append((self.chunks, first - self.end))
        self.end = first + samples
        self.chunks += chunks
        self.arrival = ROW.unpack_from(body, table - ROW.size)[3]
        self.rows.append(body[HEAD.size : table])
        self.times.append(body[table:stamps])
        self.data.append(body[stamps:])
        return len(body)

    def take(self) -> list[tuple[int, Chunk, int]]:
        """(sequence, chunk, arrival) of what was gathered: one chunk, and two more for every gap; empties the heap."""
        rows = np.frombuffer(bytearray().join(self.rows), "<i8").reshape(-1, COLUMNS)
        time = np.frombuffer(bytearray().join(self.times), "<i8").astype(np.int64, copy=False)
        data = np.frombuffer(bytearray().join(self.data), self.spec.dtype).reshape(len(time), *self.spec.shape)
        # what is lost on an empty chunk is lost before the next sample: until then time went on without a gap, as it did live
        filled = np.flatnonzero(rows[:, 0])
        gaps = [
            (0, self.pending_gap),
            *self.missed,
            *((i, int(rows[i, 2])) for i in np.flatnonzero(rows[:, 2]).tolist()),
        ]
        lost: dict[int, int] = {}
        self.pending_gap = 0
        for i, missing in gaps:
            if not missing:
                continue
            if (at := int(np.searchsorted(filled, i))) == len(filled):
                self.pending_gap = add_lost(self.pending_gap, missing)
            else:
                lost[int(filled[at])] = add_lost(lost.get(int(filled[at]), 0), missing)
        taken: list[tuple[int, Chunk, int]] = []
        bounds = [0, *np.cumsum(rows[:, 0]).tolist()]
        cuts = sorted({0, len(rows), *lost})
        for i, k in pairwise(cuts):
            if i in lost:  # what time alone brings about comes before the gap, as it did where chunks were short
                until = int(time[bounds[i]]) - 1
                taken.append((int(rows[max(i - 1, 0), 4]), empty(self.spec, until), self.arrival))
            chunk = Chunk(time[bounds[i] : bounds[k]], data[bounds[i] : bounds[k]], int(rows[k - 1, 1]), lost.get(i, 0))
            taken.append((int(rows[k - 1, 4]), chunk, self.arrival))
        self.last = int(rows[-1, 4]), int(rows[-1, 1])
        self.rows, self.times, self.data, self.missed, self.chunks = [], [], [], [], 0
        return taken


def joinable(spec: StreamSpec) -> bool:
    """Whether a stream's chunks can be joined: frames are not, they fill their messages anyway."""
    return spec.is_event or spec.dtype.kind == "f" or len(spec.shape) < 2


def joined(recording: Recording, names: set[str]) -> Iterator[tuple[int, str, Chunk, int]]:
    """(sequence, stream, chunk, arrival) of these streams, each stream in its order, all of them side by side in time.

    Streams of frames cannot be joined.
    """
    heaps: dict[str, _Heap] = {}
    opened = newest = held = 0
    for part in recording.parts:
        batch = -1
        for name, number, body, *_ in part.messages(names & part.streams.keys()):
            if number != batch and (newest - opened >= SPAN_NS or held > SPAN_BYTES):
                yield from _flush(heaps)
                opened, held = newest, 0
            batch = number
            heap = heaps.get(name)
            if heap is None:
                heap = heaps[name] = _Heap(part.streams[name].spec)
            held += heap.add(body)
            newest = max(newest, heap.arrival)
        yield from _flush(heaps)
    for name, heap in heaps.items():
        if heap.pending_gap:
            sequence, until = heap.last
            yield sequence, name, empty(heap.spec, until, heap.pending_gap), heap.arrival


def _flush(heaps: dict[str, _Heap]) -> Iterator[tuple[int, str, Chunk, int]]:
    filled = [(heap.first_sequence, name) for name, heap in heaps.items() if heap.rows]
    for _, name in sorted(filled):
        for sequence, chunk, arrival in heaps[name].take():
            yield sequence, name, chunk, arrival
