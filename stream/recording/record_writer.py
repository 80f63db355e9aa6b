"""The recorder's writer: makes messages of what the recorder was handed, and gets them onto the disk in spite of what it does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from threading import Event
from typing import Any

import structlog

from stream.chunk import NS
from stream.graph import RecordingOptions
from stream.recording.file_segments import FileSegments
from stream.recording.format import Logged, dump, encode, encode_log
from stream.recording.image import encode_image
from stream.recording.recorder_slot import OVERHEAD, STREAMS, RecorderSlot

log = structlog.get_logger(__name__)

SPOOL_BYTES = 4 << 20
"""Beyond this many bytes in memory the disk is written at once."""
ROUND_BYTES = 1 << 20
"""Beyond this many bytes of samples the gathering ends early."""
SYNC_S = 2.0
"""How often the file is forced to the disk itself, for the case of a power cut."""
GRACE_S = 5.0
"""How long one that must stop goes on trying to write to a disk that refuses."""


class RecordWriter:
    """Gathers chunks for about 100 ms, makes one message per stream of them, and writes.

    done    up to which arrival everything is on the disk (ns); 0: nothing has come yet
    error   what the disk last said, while it refuses; "" when all is well
    """

    def __init__(
        self,
        path: Path,
        slots: Sequence[RecorderSlot],
        segments: FileSegments,
        options: RecordingOptions,
        stop: Event,
        *,
        live: bool,
    ) -> None:
        """`stop` is set when the recorder is to close; `live` says that a session goes on meanwhile."""
        self._path, self._slots, self._segments, self._stop, self._live = path, slots, segments, stop, live
        self._gather_ns = round(options.gather_s * NS)
        self._batch = self._opened = self._newest = self._gathered = 0
        self._sync_due = time.monotonic()
        self._dropping: dict[str, int] | None = None
        self._reported: dict[str, int] = {}
        self.done = 0
        self.error = ""

    def take(self, number: int, what: tuple[Any, int, int], missed: int) -> None:
        """A chunk of a stream, with how many samples were dropped before it."""
        slot = self._slots[number]
        chunk, arrival, _ = what
        if arrival > self._newest:
            self._newest = arrival
        now = self._newest
        if not self._gathered:
            self._opened = now
            self.done = self.done or arrival  # until something is on the disk, all since the first chunk is behind
        elif now - self._opened >= self._gather_ns or self._gathered > ROUND_BYTES:
            self.round()
            self._opened = now
        if missed:
            self._message(number)
            slot.index += missed
        pending = slot.pending
        if not pending:
            slot.first = slot.index
        pending.append(what)
        slot.index += len(chunk.time)
        size = chunk.data.nbytes + OVERHEAD
        slot.got += size
        self._gathered += size

    def take_line(self, number: int, content: Any, time: int) -> None:
        """A line of the log (0): its kind and facts; or the metrics (1): the table."""
        self._slots[number].got += OVERHEAD
        body = dump({"time": time, "table": content}) if number else encode_log(content[0], time, content[1])
        self._segments.add(number, time, time, self._batch, body)

    def sync(self) -> None:
        """Get everything taken so far onto the disk itself."""
        self.round()
        self._sync_due = 0.0
        self.save()

    def round(self) -> None:
        """Make one message per stream of what was gathered; all of them bear one batch number, so that readers can sort them."""
        if not self._gathered:
            return
        for number in range(STREAMS, len(self._slots)):
            self._message(number)
        self._gathered = 0
        self._batch += 1
        if self._segments.waiting > SPOOL_BYTES:
            self.save()

    def _message(self, number: int) -> None:
        slot = self._slots[number]
        if not slot.pending or slot.spec is None:
            return
        entries, slot.pending = slot.pending, []
        try:
            body = encode(slot.spec, entries, slot.first, slot.kept)
        except (ValueError, TypeError) as error:
            log.error("a chunk could not be recorded", stream=slot.name, error=str(error))
            self._note("not recorded", level="error", stream=slot.name, error=str(error))
            slot.refused += len(entries)
            return
        chunk, arrival, _ = entries[0]
        stamp = int(chunk.time[0]) if len(chunk.time) else arrival
        if slot.frames:
            self._frames(slot, entries)
        self._segments.add(slot.topic, entries[-1][1] or self._newest, stamp, self._batch, body)

    def _frames(self, slot: RecorderSlot, entries: Sequence[Logged]) -> None:
        """Frames go before the table of their chunks."""
        index = slot.first
        for chunk, arrival, _ in entries:
            for stamp, frame in zip(chunk.time.tolist(), chunk.data, strict=True):
                body = slot.packer.pack(index, stamp, frame) if slot.packer else encode_image(stamp, index, frame)
                self._segments.add(slot.frames, arrival or self._newest, stamp, self._batch, body)
                index += 1

    def save(self) -> None:
        """Write everything, however long it takes; while the disk refuses, the queue fills, and then the session's chunks are dropped."""
        since, pause = time.monotonic(), 0.1
        while True:
            now = time.monotonic()
            try:
                self._segments.save(sync=now >= self._sync_due)
                break
            except OSError as error:
                self.fail(error)
                if self._stop.is_set() and now > since + GRACE_S:
                    raise
            if self._stop.wait(pause):
                time.sleep(0.1)
            pause = min(pause * 1.5, 5.0)
        self._sync_due = now + SYNC_S if now >= self._sync_due else self._sync_due
        self.done = self._opened if self._gathered else self._newest
        if self.error:
            waited = round(time.monotonic() - since, 1)
            log.warning("recording goes on", path=str(self._path), waited_s=waited, after=self.error)
            self._note("disk refused", level="warning", error=self.error, waited_s=waited)
            self.error = ""

    def _note(self, kind: str, **facts: Any) -> None:
        """The recorder's own line in the session's log."""
        self._segments.add(0, self._newest, self._newest, self._batch, encode_log(kind, self._newest, facts))

    def fail(self, error: OSError) -> None:
        text = error.strerror or str(error)
        if not self.error:
            goes_on = "; the session goes on" if self._live else ""
            log.error(f"the recording cannot be written{goes_on}", path=str(self._path), error=text)
        self.error = text

    def report_drops(self, *, over: bool) -> None:
        """Say once when chunks begin to be dropped; write into the session's log, when it is over, how many there were."""
        dropped = {slot.name: slot.dropped for slot in self._slots if slot.dropped}
        news = {
            name: n - self._reported.get(name, 0) for name, n in dropped.items() if n != self._reported.get(name, 0)
        }
        if news and self._dropping is None:
            log.error("the disk is too slow or full: chunks are not recorded", path=str(self._path), streams=list(news))
        if news and (over or dropped == self._dropping):
            self._note("recorder dropped", level="error", chunks=news)
            self._reported, self._dropping = dropped, None
        elif news:
            self._dropping = dropped
