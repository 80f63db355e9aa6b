"""The recorder's writer: makes messages of what the recorder was handed, and gets them onto the disk in spite of what it does."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from threading import Event
from typing import Any

import structlog

from kinegraph.stream.recording.format.image import encode_image
from kinegraph.stream.recording.format.layout import dump, encode_log
from kinegraph.stream.recording.write.file_segments import FileSegments
from kinegraph.stream.recording.write.message_batches import MessageBatch
from kinegraph.stream.recording.write.message_builder import MessageBuilder
from kinegraph.stream.recording.write.recorder_slot import OVERHEAD, RecorderSlot

log = structlog.get_logger(__name__)

SPOOL_BYTES = 4 << 20
"""Beyond this many bytes in memory the disk is written at once."""
SYNC_S = 2.0
"""How often the file is forced to the disk itself, for the case of a power cut."""
GRACE_S = 5.0
"""How long one that must stop goes on trying to write to a disk that refuses."""


class RecordWriter:
    """Makes messages of what was gathered, and writes them.

    done    up to which arrival everything is on the disk (ns); 0: nothing has come yet
    error   the disk's last error, while it refuses; else ""
    """

    def __init__(
        self,
        path: Path,
        slots: Sequence[RecorderSlot],
        segments: FileSegments,
        stop: Event,
        *,
        live: bool,
    ) -> None:
        """`stop` is set when the recorder is to close; `live` says that a session goes on meanwhile."""
        self._path, self._slots, self._segments, self._stop, self._live = path, slots, segments, stop, live
        self._batch = self._newest = 0
        self._sync_due = time.monotonic()
        self._dropping: dict[str, int] | None = None
        self._reported: dict[str, int] = {}
        self.done = 0
        self.error = ""

    def take(self, gathered: MessageBatch) -> None:
        """The messages of a round; all of them bear one batch number, so that readers can sort them."""
        self._newest = gathered.newest
        for slot, message in gathered.messages:
            self._frames(slot, message)
            self._segments.add(slot.topic, message.arrival or self._newest, message.began, self._batch, message.body())
            slot.got += message.size
        self._batch += 1
        if self._segments.waiting > SPOOL_BYTES:
            self.save()

    def _frames(self, slot: RecorderSlot, message: MessageBuilder) -> None:
        """Frames go before the table of their chunks."""
        index = message.first
        for arrival, stamps, frames in message.frames:
            for stamp, frame in zip(stamps, frames, strict=True):
                body = slot.packer.pack(index, stamp, frame) if slot.packer else encode_image(stamp, index, frame)
                self._segments.add(slot.frames, arrival or self._newest, stamp, self._batch, body)
                index += 1

    def take_line(self, number: int, content: Any, time: int) -> None:
        """A line of the log (0): its kind and facts; or the metrics (1): the table."""
        self._slots[number].got += OVERHEAD
        body = dump({"time": time, "table": content}) if number else encode_log(content[0], time, content[1])
        self._segments.add(number, time, time, self._batch, body)

    def sync(self) -> None:
        """Get everything taken so far onto the disk itself."""
        self._sync_due = 0.0
        self.save()

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
        self.done = self._newest
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
