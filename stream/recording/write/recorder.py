"""The recorder: a thread of its own that writes what a session hands it, and that a slow or full disk never makes the session wait for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from threading import Event
from typing import Any, Self

import structlog

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.data.bounded import LEAST
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording.format.image import is_frames
from kinegraph.stream.recording.format.layout import LOG, METRICS, Kept, Role
from kinegraph.stream.recording.format.packed import Packer
from kinegraph.stream.recording.format.paths import lock_recording, unlock_recording
from kinegraph.stream.recording.read.reader import missing_at
from kinegraph.stream.recording.write.file_segments import FileSegments
from kinegraph.stream.recording.write.message_batches import MessageBatches
from kinegraph.stream.recording.write.record_writer import GRACE_S, SPOOL_BYTES, RecordWriter
from kinegraph.stream.recording.write.recorder_slot import OVERHEAD, STREAMS, RecorderSlot, RecorderStatus
from kinegraph.stream.recording.write.recorder_thread import Handed, RecorderThread

PIECE_BYTES = LEAST // 2
"""A chunk with more is recorded in pieces. Readers unpack more than this of any piece of a file, whatever it packs to."""
MAX_AT_ONCE = PIECE_BYTES + OVERHEAD

log = structlog.get_logger(__name__)


class Recorder:
    """Records a session. `write`, `log` and `metrics` cost a microsecond, never wait, and may come from any thread (one per stream).

    What the disk does not take within `queue_bytes` of memory is dropped and counted; the status and the log say so. With `wait`
    (offline work: an import, a replay to a file) nothing is dropped: the writer waits instead, and the layout depends on the data alone.
    With `waits` (a session with sources that can wait) it waits too, unless the disk refuses for some seconds.
    """

    def __init__(
        self,
        path: Path,
        header: dict[str, Any],
        options: RecordingOptions,
        *,
        resume: bool = False,
        wait: bool = False,
        waits: bool = False,
        queue_bytes: int = 64 << 20,
    ) -> None:
        """`path` is a session's folder, or a file's name ending in .mcap; `header` the graph, versions and facts (JSON-like).

        Raises RecordingError if nothing can be written there, if another process records there, or if a recording already exists
        (with `resume`, a further part is added to it).
        """
        self._path, self._options = path, options
        self._wait, self.waits, self._limit = wait, wait or waits, queue_bytes
        self._share = self._much = 0
        self._missing = ""
        self._slots = [RecorderSlot(LOG), RecorderSlot(METRICS)]
        self._queue: SimpleQueue[Handed] = SimpleQueue()
        self._rounds = MessageBatches(self._slots, round(options.gather_s * NS), self._queue.put)
        self._lock, number = lock_recording(path, taken=resume)
        self._segments = FileSegments(path, number, header, options, live=not wait)
        stop = Event()
        self._writer = RecordWriter(path, self._slots, self._segments, stop, live=not wait)
        self._thread = RecorderThread(
            self._queue, self._rounds, self._writer, self._segments, stop, flush_s=options.flush_s, live=not wait
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_stream(self, name: str, spec: StreamSpec, role: Role, first: int = 0, *, outline: bool = False) -> int:
        """Declare a stream; returns its number for `write`. `first` is the cumulative index of the sample it starts with.

        Of an `outline`, only when samples came and how many is kept, not the samples.
        """
        if any(slot.name == name for slot in self._slots):
            raise RecordingError(f"stream {name!r} is recorded already")
        if not outline and spec.sample_bytes > PIECE_BYTES:
            raise RecordingError(
                f"stream {name!r}: a sample of it has {spec.sample_bytes} bytes; at most {PIECE_BYTES} can be recorded"
            )
        kept: Kept = "outline" if outline else self._options.frames if is_frames(spec) else "whole"
        slot = RecorderSlot(
            name,
            spec,
            index=first,
            kept=kept,
            copied=role == "input",
            topic=self._segments.declare(name, spec, role, kept),
        )
        if kept in ("image", "packed"):
            slot.frames = self._segments.declare_frames(name, kept)
            slot.packer = Packer() if kept == "packed" else None
        self._slots.append(slot)
        # each stream has its share, so that a camera cannot push out the muscles' few bytes
        self._share = self._limit // (len(self._slots) - STREAMS)
        self._much = min(SPOOL_BYTES, self._share // 4)
        return len(self._slots) - 1

    def write(self, stream: int, chunk: Chunk, arrival: int, sequence: int, *, owned: bool = False) -> None:
        """Hand over a chunk: its arrival (ns of session time) and its place in the input log. An input is copied, unless its memory is
        the session's own (`owned`); other arrays are never written again."""
        slot, n = self._slots[stream], len(chunk.time)
        size = (0 if slot.kept == "outline" else chunk.data.nbytes) + OVERHEAD
        # a reader takes a message whole into memory, and a compressor a chunk
        if size + 8 * n > MAX_AT_ONCE and n > 1:
            for piece in _pieces(chunk):
                self.write(stream, piece, arrival, sequence, owned=owned)
            return
        # two counters that only one thread each writes: no lock on the graph's thread
        if slot.put - slot.got > self._much and not self._has_room(slot):
            slot.dropped += 1
            slot.missed += n
            return
        try:
            self._rounds.add(slot, n, size, chunk, arrival, sequence, owned=owned)
        except (ValueError, TypeError) as error:
            slot.refused += 1
            log.error("a chunk could not be recorded", stream=slot.name, error=str(error))
            self.log("not recorded", arrival, level="error", stream=slot.name, error=str(error))

    def log(self, kind: str, time: int, **facts: Any) -> None:
        """A line of the session's log at `time` (ns): a drop, a gap, a reopened source, an alarm. The fact `level` may be given."""
        self._hand(0, (kind, facts), time)

    def metrics(self, time: int, table: dict[str, Any]) -> None:
        """The nodes' metrics at `time` (ns); the table must not be changed afterwards."""
        self._hand(1, table, time)

    def _hand(self, topic: int, what: Any, time: int) -> None:
        slot = self._slots[topic]
        # a log that is written in a loop must not take the memory that samples need
        if slot.put - slot.got > self._limit // 8:
            slot.dropped += 1
            return
        slot.put += OVERHEAD
        self._queue.put((topic, what, time))

    def _has_room(self, slot: RecorderSlot) -> bool:
        """Much of a stream waits: the recorder is woken; whether there is still room for more."""
        self._thread.wake()
        return slot.put - slot.got <= self._share or not self._is_full() or self._wait_for_room()

    def _is_full(self) -> bool:
        return sum(slot.put - slot.got for slot in self._slots) > self._limit

    def _wait_for_room(self) -> bool:
        """Where nothing is live, the writer waits; where the disk refuses for some seconds, offline raises RecordingError."""
        well = time.monotonic()
        if self.waits and self._rounds.size > self._limit:
            self._rounds.end()
        while self.waits and self._thread.alive and self._is_full():
            now = time.monotonic()
            well = well if self._writer.error else now
            if now - well > GRACE_S:
                if self._wait:
                    raise self._incomplete()
                return False
            time.sleep(0.002)
        return self.waits and self._thread.alive

    @property
    def part(self) -> int:
        """The number of the file that is being written."""
        return self._segments.number

    @property
    def handed(self) -> int:
        """The newest arrival so far (ns)."""
        return self._rounds.newest

    @property
    def saved(self) -> int:
        """Up to which arrival everything is on the disk (ns)."""
        return self._writer.done

    @property
    def status(self) -> RecorderStatus:
        return RecorderStatus(
            bytes=self._segments.saved,
            behind_s=max(self._rounds.newest - (self._writer.done or self._rounds.oldest), 0) / NS,
            dropped={slot.name: lost for slot in self._slots if (lost := slot.dropped + slot.refused)},
            error=self._writer.error,
            missing=self._missing,
        )

    def idle_hint(self) -> None:
        """The session has nothing to do just now. The recorder's thread shares the interpreter with it, and works best in between."""
        self._thread.idle_hint()

    @property
    def patient(self) -> bool:
        """Whether the recorder's work is due, and waits a little for a lull in the session's."""
        return self._thread.patient

    def flush(self, timeout_s: float = 5.0) -> bool:
        """Wait until everything handed over so far is on the disk itself; returns whether it is. Not for the graph's thread."""
        done = Event()
        # an end in the queue: once it is reached, all that was handed over before is on the disk
        self._rounds.end(done)
        self._thread.wake()
        return done.wait(timeout_s)

    def close(self) -> None:
        """Write what is left and the end, and wait for it; a disk that refuses is given up after some seconds."""
        self._thread.close()
        if self._segments.disturbed:
            self._missing = missing_at(self._path)
        unlock_recording(self._path, self._lock)

    def check(self) -> None:
        """Raises RecordingError where something that was handed over is not on the disk; for offline work, after `close`."""
        if self.status.shortfall:
            raise self._incomplete()

    def _incomplete(self) -> RecordingError:
        why = self._writer.error or self._missing or "the disk was too slow"
        return RecordingError(
            f"{self._path}: not everything could be written ({why}); free some space or choose another folder"
        )


def _pieces(chunk: Chunk) -> Iterator[Chunk]:
    """A large chunk in several; chunks carry no meaning."""
    n = max(1, PIECE_BYTES * len(chunk.time) // (chunk.data.nbytes + chunk.time.nbytes))
    return (chunk.part(at, min(at + n, len(chunk.time))) for at in range(0, len(chunk.time), n))
