"""The files of a recording, one after the other: messages come in, and get onto the disk in spite of what it does."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import structlog
from mcap.writer import CompressionType

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording.format.layout import LOG, METRICS, Kept, Role, table
from kinegraph.stream.recording.format.overview import OverviewWriter, overview_of
from kinegraph.stream.recording.format.paths import part_path
from kinegraph.stream.recording.format.recorded_stream import RecordedStream
from kinegraph.stream.recording.write.file_segment import DisturbedError, FileSegment
from kinegraph.stream.recording.write.quota import keep_quota
from kinegraph.stream.system.atomic_file import private_folder

log = structlog.get_logger(__name__)

MAX_SAVES = 2400
"""A file ends after this many saves (a quarter of an hour), for its index is held in memory until then: 1 to 3 KB per save."""
MAX_S = 900.0
"""A session's file is ended once a stream's samples span this much time, however fast: overviews are held in memory until then."""
FULL = (errno.ENOSPC, errno.EDQUOT)
"""What a full disk says: it is waited for, and the file goes on where it stopped."""


@dataclass(slots=True)
class Topic:
    """A topic: a stream's chunks, its frames (`frames`), or (without a spec) the log or the metrics."""

    name: str
    spec: StreamSpec | None = None
    role: Role = "edge"
    kept: Kept = "whole"
    channel: int = 0
    tally: RecordedStream | None = None
    frames: bool = False
    overview: OverviewWriter | None = None


class FileSegments:
    """Used by the recorder's thread alone, but for `declare`, which any thread may call, and `saved`, which it may read."""

    def __init__(
        self, path: Path, number: int, header: dict[str, Any], options: RecordingOptions, *, live: bool = False
    ) -> None:
        """`number` is that of the first part to be written; a `live` session's parts end after `MAX_S`."""
        self._path, self._number, self._header, self._options = path, number, header, options
        self._live, self._longest = live, MAX_S if live else inf
        self._topics = [Topic(LOG), Topic(METRICS)]
        self._part: FileSegment | None = None
        self._declared = self._saves = 0
        self._closed_bytes = 0
        self.disturbed = False
        """Whether another program has deleted, moved or cut a file."""
        self._unsaved: list[tuple[int, int, int, int, bytes]] = []

    def declare(self, name: str, spec: StreamSpec, role: Role, kept: Kept = "whole") -> int:
        """A further stream; returns its number (0 and 1 are the log and the metrics)."""
        topic = Topic(name, spec, role, kept, tally=RecordedStream(spec, role, kept))
        topic.overview = overview_of(spec, kept)
        self._topics.append(topic)
        return len(self._topics) - 1

    def declare_frames(self, name: str, kept: Kept) -> int:
        """Where a stream's frames go; returns the number."""
        self._topics.append(Topic(name, kept=kept, frames=True))
        return len(self._topics) - 1

    @property
    def number(self) -> int:
        """Of the part that is being written, or comes next; those before it are closed."""
        return self._number

    @property
    def saved(self) -> int:
        """Bytes on the disk."""
        part = self._part
        return self._closed_bytes + (part.saved if part else 0)

    @property
    def waiting(self) -> int:
        """About how many bytes `save` would write; a file that has not begun counts as one that must be."""
        return self._part.waiting if self._part is not None else 1 << 62

    def add(self, number: int, log_time: int, publish_time: int, batch: int, body: bytes) -> None:
        """A message, to memory. It is kept until `save` has succeeded, for a file may have to be given up in between."""
        message = (number, log_time, publish_time, batch, body)
        self._unsaved.append(message)
        if self._part is not None:
            self._write(self._part, *message)

    def save(self, *, sync: bool) -> None:
        """Get everything onto the disk, in a new file if need be. Raises OSError; then it can be tried again, and nothing is lost."""
        if self._part is None:
            self._begin()
        assert self._part is not None
        try:
            self._part.save(sync=sync)
        except OSError as error:
            self.disturbed = self.disturbed or isinstance(error, DisturbedError)
            if error.errno not in FULL:
                self._leave()
            raise
        self._unsaved.clear()
        self._saves += 1
        if 0 < self._options.rotate_mb * 1e6 <= self._part.saved or self._is_long():
            self.finish()

    def _is_long(self) -> bool:
        """Whether the current file's index and overviews have taken their share of memory."""
        tallies = (topic.tally for topic in self._topics if topic.tally is not None)
        return self._saves >= MAX_SAVES or any(tally.duration_s >= self._longest for tally in tallies)

    def finish(self) -> None:
        """Write the end of the current file. Raises OSError; it can be tried again."""
        if self._part is None:
            return
        overviews = {t.name: packed for t in self._topics if t.overview and (packed := t.overview.pack())}
        self._part.finish({t.name: t.tally.to_json() for t in self._topics if t.tally is not None}, overviews)
        self._closed_bytes += self._part.saved
        self._part = None
        self._number += 1

    def abandon(self) -> None:
        """Leave the current file as a killed process would."""
        if self._part is not None:
            self._leave()

    def _begin(self) -> None:
        """A new file, which holds first what could not be saved in the last one. Frames are compressed fast, the rest well."""
        frames = any(topic.frames for topic in self._topics)
        for gone in keep_quota(self._path, self._options.quota_mb):
            log.info("an old recording was deleted to keep the quota", path=str(gone), quota_mb=self._options.quota_mb)
        path = part_path(self._path, self._number)
        private_folder(path.parent)  # it may have been deleted since
        part = FileSegment(
            path,
            self._number,
            self._header,
            CompressionType.LZ4 if frames else CompressionType.ZSTD,
            live=self._live,
        )
        self._part, self._declared, self._saves = part, 0, 0
        for topic in self._topics:
            topic.tally = RecordedStream(topic.spec, topic.role, topic.kept) if topic.spec else None
            topic.overview = overview_of(topic.spec, topic.kept) if topic.spec else None
        self._declare(part)
        for message in self._unsaved:
            self._write(part, *message)

    def _leave(self) -> None:
        """Give up a file that cannot grow (its own error, not a full disk): what it does not hold goes to the next one."""
        part, self._part = self._part, None
        assert part is not None
        self._closed_bytes += part.saved
        self._number += bool(part.saved)
        try:
            part.abandon()
        except OSError as error:
            log.warning("a part of the recording could not be closed", path=str(part.path), error=str(error))

    def _declare(self, part: FileSegment) -> None:
        while self._declared < len(self._topics):
            topic = self._topics[self._declared]
            if topic.frames:
                topic.channel = part.declare_frames(topic.name, topic.kept)
            elif topic.spec is None:
                topic.channel = part.channel_of(topic.name)
            else:
                topic.channel = part.declare(topic.name, topic.spec, topic.role, topic.kept)
            self._declared += 1

    def _write(self, part: FileSegment, number: int, log_time: int, publish_time: int, batch: int, body: bytes) -> None:
        self._declare(part)
        topic = self._topics[number]
        part.add(topic.channel, log_time, publish_time, batch, body)
        if topic.tally is not None:
            topic.tally.count(table(body))
        if topic.overview is not None:
            topic.overview.add(body)
