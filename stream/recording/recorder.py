"""The recorder: a thread of its own that writes what a session hands it, and that a slow or full disk never makes the session wait for."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, Self

import structlog
from mcap.writer import CompressionType

from stream.chunk import NS, Chunk, StreamSpec
from stream.errors import RecordingError
from stream.graph import RecordingOptions
from stream.recording.format import LOG, METRICS, Entry, Role, dump, encode, encode_log, table
from stream.recording.part import Part
from stream.recording.place import SUFFIX, lock, part_path, parts_of
from stream.recording.quota import keep_quota
from stream.recording.tally import RecordedStream

log = structlog.get_logger(__name__)

OVERHEAD = 400
"""Bytes that a waiting chunk takes beside its samples."""
SPOOL_BYTES = 4 << 20
"""Beyond this many bytes in memory the disk is written at once."""
ROUND_BYTES = 1 << 20
"""Beyond this many bytes of samples the gathering ends early."""
SYNC_S = 2.0
"""How often the file is forced to the disk itself, for the case of a power cut."""
GRACE_S = 5.0
"""How long `close` goes on trying to write to a disk that refuses."""
FLUSH = -1
"""Stands for a stream's number where everything must be written now."""
FULL = (errno.ENOSPC, errno.EDQUOT)


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
class _Lane:
    """What is known of one stream (or of the log, or of the metrics) while it is recorded. Counters have one writing thread each."""

    name: str
    spec: StreamSpec | None = None
    role: Role = "edge"
    index: int = 0
    """Cumulative index of the next sample; the recorder's thread alone."""
    put: int = 0
    """Bytes handed over; the stream's thread alone."""
    got: int = 0
    """Bytes taken; the recorder's thread alone."""
    dropped: int = 0
    missed: int = 0
    """Chunks dropped in all, samples dropped since the last one accepted; the stream's thread alone."""
    pending: list[Entry] = field(default_factory=list)
    first: int = 0
    """Index of the first pending sample."""
    channel: int = 0
    tally: RecordedStream | None = None


class Recorder:
    """Records a session. `write`, `log` and `metrics` cost a microsecond, never wait, and may come from any thread (one per stream).

    What the disk does not take within `queue_bytes` of memory is dropped and counted; the status and the log say so. With `wait`
    (offline work: an import, a replay to a file) nothing is dropped: the writer waits instead, and the layout depends on the data alone.
    """

    def __init__(
        self,
        path: Path,
        header: dict[str, Any],
        options: RecordingOptions,
        *,
        resume: bool = False,
        wait: bool = False,
        queue_bytes: int = 64 << 20,
    ) -> None:
        """`path` is a session's folder, or a file's name ending in .mcap; `header` the graph, versions and facts (JSON-like).

        Raises RecordingError if nothing can be written there, if another process records there, or if a recording is there already
        (with `resume`, a further part is added to it).
        """
        self._path, self._header, self._options = path, header, options
        self._wait, self._limit = wait, queue_bytes
        self._lanes = [_Lane(LOG), _Lane(METRICS)]
        self._declared = 0
        self._queue: SimpleQueue[tuple[int, Any, int, int, int]] = SimpleQueue()
        self._share = queue_bytes
        self._latest = self._done = 0
        self._batch = 0
        self._opened = 0
        self._gathered = 0
        self._unsaved: list[tuple[int, int, int, int, bytes]] = []
        self._closed_bytes = 0
        self._error = ""
        self._dropping: dict[str, int] | None = None
        self._reported: dict[str, int] = {}
        self._part: Part | None = None
        self._lock = self._claim(resume)
        self._due = self._sync_due = time.monotonic()
        self._stop = Event()
        self._thread = Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def _claim(self, resume: bool) -> Any:
        """Lock the place, and prove that it can be written."""
        folder = self._path.parent if self._path.suffix == SUFFIX else self._path
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(
                f"{folder}: cannot be created ({error.strerror or error}); choose a folder that can be written"
            ) from None
        held = lock(self._path)
        parts = parts_of(self._path)
        self._number = len(parts) if not parts or parts[0] == self._path else int(parts[-1].stem.rpartition(".")[2]) + 1
        if parts and not resume:
            held.release()
            raise RecordingError(f"{self._path}: holds a recording already; name another place, or resume that session")
        try:
            _probe(part_path(self._path, self._number))
        except OSError as error:
            held.release()
            raise RecordingError(
                f"{self._path}: cannot write there ({error.strerror or error}); free some space or choose another folder"
            ) from None
        return held

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- called by the session

    def add_stream(self, name: str, spec: StreamSpec, role: Role, first: int = 0) -> int:
        """Declare a stream; returns its number for `write`. `first` is the cumulative index of the sample it starts with."""
        if any(lane.name == name for lane in self._lanes):
            raise RecordingError(f"stream {name!r} is recorded already")
        self._lanes.append(_Lane(name, spec, role, index=first, tally=RecordedStream(spec, role)))
        self._share = self._limit // (len(self._lanes) - 2)
        return len(self._lanes) - 1

    def write(self, stream: int, chunk: Chunk, arrival: int, sequence: int) -> None:
        """Hand over a chunk: its arrival (ns of session time) and its place in the input log. Its arrays are never written again."""
        lane = self._lanes[stream]
        if lane.put - lane.got > self._share and self._is_full() and not self._wait_for_room():
            lane.dropped += 1
            lane.missed += len(chunk.time)
            return
        lane.put += chunk.data.nbytes + OVERHEAD
        self._latest = arrival
        self._queue.put((stream, chunk, arrival, sequence, lane.missed))
        if lane.missed:
            lane.missed = 0

    def log(self, kind: str, time: int, **facts: Any) -> None:
        """A line of the session's log at `time` (ns): a drop, a gap, a reopened source, an alarm. The fact `level` may be given."""
        self._hand(0, (kind, facts), time)

    def metrics(self, time: int, table: dict[str, Any]) -> None:
        """The nodes' metrics at `time` (ns); the table must not be changed afterwards."""
        self._hand(1, table, time)

    def _hand(self, topic: int, what: Any, time: int) -> None:
        lane = self._lanes[topic]
        if lane.put - lane.got > self._limit // 8:
            lane.dropped += 1
            return
        lane.put += OVERHEAD
        self._queue.put((topic, what, time, 0, 0))

    def _is_full(self) -> bool:
        return sum(lane.put - lane.got for lane in self._lanes) > self._limit

    def _wait_for_room(self) -> bool:
        while self._wait and self._thread.is_alive() and self._is_full():
            time.sleep(0.002)
        return self._wait and self._thread.is_alive()

    @property
    def status(self) -> RecorderStatus:
        part = self._part
        return RecorderStatus(
            bytes=self._closed_bytes + (part.saved if part else 0),
            behind_s=max(self._latest - self._done, 0) / NS if self._latest else 0.0,
            dropped={lane.name: lane.dropped for lane in self._lanes if lane.dropped},
            error=self._error,
        )

    def flush(self, timeout_s: float = 5.0) -> bool:
        """Wait until everything handed over so far is on the disk itself; returns whether it is. Not for the graph's thread."""
        done = Event()
        self._queue.put((FLUSH, done, 0, 0, 0))
        return done.wait(timeout_s)

    def close(self) -> None:
        """Write what is left and the end, and wait for it; a disk that refuses is given up after some seconds."""
        self._stop.set()
        self._thread.join()
        self._lock.release()

    # -- the recorder's thread

    def _run(self) -> None:
        try:
            while not self._stop.wait(min(self._options.gather_s, 0.01) if self._wait else self._options.gather_s):
                self._turn()
            self._turn(last=True)
            self._finish()
        except OSError as error:
            self._fail(error)
            if self._part is not None:
                self._part.abandon()
        finally:
            if not self._stop.is_set():
                self._error = self._error or "the recorder has stopped"
            if self._part is not None:
                self._closed_bytes += self._part.saved
                self._part = None

    def _turn(self, *, last: bool = False) -> None:
        """Take what has come, make messages of it, and write when it is time."""
        while True:
            try:
                item = self._queue.get_nowait()
            except Empty:
                break
            self._take(*item)
        if last or not self._wait:
            self._round()
        self._report_drops()
        now = time.monotonic()
        if now >= self._due or last:
            self._save()
            self._due = now + self._options.flush_s

    def _take(self, number: int, what: Any, arrival: int, sequence: int, missed: int) -> None:
        if number == FLUSH:
            self._round()
            self._sync_due = 0.0
            self._save()
            what.set()
            return
        lane = self._lanes[number]
        if lane.spec is None:
            lane.got += OVERHEAD
            body = dump({"time": arrival, "table": what}) if number else encode_log(what[0], arrival, what[1])
            self._add(number, arrival, arrival, body)
            return
        if self._gathered and (arrival - self._opened >= self._options.gather_s * NS or self._gathered > ROUND_BYTES):
            self._round()
        if not self._gathered:
            self._opened = arrival
        if missed:
            self._message(number)
            lane.index += missed
        if not lane.pending:
            lane.first = lane.index
        lane.pending.append(Entry(what, arrival, sequence))
        lane.index += len(what.time)
        size = what.data.nbytes + OVERHEAD
        lane.got += size
        self._gathered += size

    def _round(self) -> None:
        """Make one message per stream of what was gathered; all of them bear one batch number, so that readers can sort them."""
        if not self._gathered:
            return
        for number in range(2, len(self._lanes)):
            self._message(number)
        self._gathered = 0
        self._batch += 1
        if self._part is None or self._part.waiting > SPOOL_BYTES:
            self._save()

    def _message(self, number: int) -> None:
        lane = self._lanes[number]
        if not lane.pending or lane.spec is None:
            return
        entries, lane.pending = lane.pending, []
        try:
            body = encode(lane.spec, entries, lane.first)
        except (ValueError, TypeError) as error:
            log.error("a chunk could not be recorded", stream=lane.name, error=str(error))
            self._add(
                0,
                entries[0].arrival,
                0,
                encode_log("not recorded", entries[0].arrival, {"stream": lane.name, "error": str(error)}),
            )
            return
        stamp = int(entries[0].chunk.time[0]) if len(entries[0].chunk.time) else entries[0].arrival
        self._add(number, entries[-1].arrival, stamp, body)

    def _add(self, number: int, log_time: int, publish_time: int, body: bytes) -> None:
        if self._part is not None:
            self._to_part(number, log_time, publish_time, self._batch, body)
        self._unsaved.append((number, log_time, publish_time, self._batch, body))

    def _to_part(self, number: int, log_time: int, publish_time: int, batch: int, body: bytes) -> None:
        assert self._part is not None
        self._declare()
        lane = self._lanes[number]
        self._part.add(lane.channel, log_time, publish_time, batch, body)
        if lane.tally is not None:
            lane.tally.count(table(body))

    def _declare(self) -> None:
        assert self._part is not None
        while self._declared < len(self._lanes):
            lane = self._lanes[self._declared]
            lane.channel = (
                self._part.channel_of(lane.name)
                if lane.spec is None
                else self._part.declare(lane.name, lane.spec, lane.role)
            )
            self._declared += 1

    # -- the disk

    def _save(self) -> None:
        """Write everything, however long it takes; while the disk refuses, the queue fills, and then the session's chunks are dropped."""
        since, pause = time.monotonic(), 0.2
        while True:
            try:
                self._try_to_save()
                break
            except OSError as error:
                self._fail(error)
                if error.errno not in FULL and self._part is not None:
                    self._leave_part()
                if self._stop.is_set() and time.monotonic() > since + GRACE_S:
                    raise
            self._stop.wait(pause) if not self._stop.is_set() else time.sleep(min(pause, 0.5))
            pause = min(pause * 1.5, 5.0)
        if self._error:
            waited = round(time.monotonic() - since, 1)
            log.warning("recording goes on", path=str(self._path), waited_s=waited, after=self._error)
            self._add(
                0,
                self._latest,
                self._latest,
                encode_log(
                    "disk refused", self._latest, {"level": "warning", "error": self._error, "waited_s": waited}
                ),
            )
            self._error = ""

    def _try_to_save(self) -> None:
        if self._part is None:
            self._begin_part()
        assert self._part is not None
        now = time.monotonic()
        sync = now >= self._sync_due
        self._part.save(sync=sync)
        if sync:
            self._sync_due = now + SYNC_S
        self._unsaved.clear()
        self._done = self._latest if self._queue.empty() else self._opened
        if 0 < self._options.rotate_mb * 1e6 <= self._part.saved:
            self._end_part()

    def _begin_part(self) -> None:
        frames = any(len(lane.spec.shape) == 2 and lane.spec.dtype.itemsize == 2 for lane in self._lanes if lane.spec)
        compression = CompressionType.LZ4 if frames else CompressionType.ZSTD
        self._keep_quota()
        self._part = Part(part_path(self._path, self._number), self._number, self._header, compression)
        self._declared = 0
        for lane in self._lanes:
            lane.tally = RecordedStream(lane.spec, lane.role) if lane.spec else None
        self._declare()
        for item in self._unsaved:
            self._to_part(*item)

    def _end_part(self) -> None:
        """Finish a file; the next one begins with the next message."""
        assert self._part is not None
        self._part.finish(self._summary())
        self._closed_bytes += self._part.saved
        self._part = None
        self._number += 1

    def _leave_part(self) -> None:
        """Give up a file that cannot grow (its own error, not a full disk): what it does not hold goes to the next one."""
        part, self._part = self._part, None
        assert part is not None
        self._closed_bytes += part.saved
        try:
            part.abandon()
        except OSError as error:
            log.warning("a part of the recording could not be closed", path=str(part.path), error=str(error))
        if part.saved:
            self._number += 1

    def _finish(self) -> None:
        if self._part is not None:
            self._part.finish(self._summary())

    def _summary(self) -> dict[str, Any]:
        return {lane.name: lane.tally.to_json() for lane in self._lanes if lane.tally is not None}

    def _keep_quota(self) -> None:
        for gone in keep_quota(self._path, self._options.quota_mb):
            log.info("an old recording was deleted to keep the quota", path=str(gone), quota_mb=self._options.quota_mb)

    # -- what goes wrong

    def _fail(self, error: OSError) -> None:
        text = error.strerror or str(error)
        if not self._error:
            log.error("the recording cannot be written; the session goes on", path=str(self._path), error=text)
        self._error = text

    def _report_drops(self) -> None:
        """Say once when chunks begin to be dropped; write into the log, when it is over, how many there were."""
        dropped = {lane.name: lane.dropped for lane in self._lanes if lane.dropped}
        before = self._dropping
        if before is None:
            if dropped != self._reported:
                log.error(
                    "the disk is too slow: chunks are not recorded",
                    path=str(self._path),
                    streams=_names(dropped, self._reported),
                )
                self._dropping = dropped
        elif dropped == before:
            missing = {
                name: n - self._reported.get(name, 0) for name, n in dropped.items() if n != self._reported.get(name, 0)
            }
            facts = {"level": "error", "chunks": missing}
            self._add(0, self._latest, self._latest, encode_log("recorder dropped", self._latest, facts))
            self._reported, self._dropping = dropped, None
        else:
            self._dropping = dropped


def _names(now: dict[str, int], before: dict[str, int]) -> Iterable[str]:
    return [name for name, n in now.items() if n != before.get(name, 0)]


def _probe(path: Path) -> None:
    """Write a little at `path` and remove it again: raises OSError where the disk is full or may not be written."""
    trial = path.with_name(f".{path.name}.trial")
    try:
        with trial.open("wb") as file:
            file.write(bytes(4096))
            file.flush()
    finally:
        trial.unlink(missing_ok=True)
