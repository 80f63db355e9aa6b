"""The recorder: a thread of its own that writes what a session hands it, and that a slow or full disk never makes the session wait for."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, Self

import numpy as np
import structlog

from stream.chunk import NS, Chunk, StreamSpec
from stream.errors import RecordingError
from stream.graph import RecordingOptions
from stream.recording.format import LOG, METRICS, Kept, Logged, Role, dump, encode, encode_log
from stream.recording.image import encode_image, is_frames
from stream.recording.lane import OVERHEAD, Lane, RecorderStatus
from stream.recording.packed import Packer
from stream.recording.place import claim, give_back
from stream.recording.tape import Tape

log = structlog.get_logger(__name__)

SPOOL_BYTES = 4 << 20
"""Beyond this many bytes in memory the disk is written at once."""
ROUND_BYTES = 1 << 20
"""Beyond this many bytes of samples the gathering ends early."""
TURN = 0.8
"""So much of `flush_s` the recorder's thread sleeps, unless much comes; then it writes all that came."""
PATIENCE_S = 0.02
"""How long the recorder waits for a moment at which the session has nothing to do."""
SYNC_S = 2.0
"""How often the file is forced to the disk itself, for the case of a power cut."""
NOTHING = np.empty(0)
"""Stands for samples that are not kept; a view of them would hold them in memory."""
STREAMS = 2
"""The number of the first stream, after the log and the metrics."""
FLUSH = -1
"""Stands for a stream's number where everything must be written now."""
GRACE_S = 5.0
"""How long `close` goes on trying to write to a disk that refuses."""


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
        self._path, self._options = path, options
        self._wait, self._limit = wait, queue_bytes
        self._share = self._much = 0
        self._lanes = [Lane(LOG), Lane(METRICS)]
        self._queue: SimpleQueue[tuple[int, tuple[Any, int, int], int]] = SimpleQueue()
        self._latest = self._done = 0
        self._batch = self._opened = self._newest = self._gathered = 0
        self._error = ""
        self._packer: Packer | None = None
        self._dropping: dict[str, int] | None = None
        self._reported: dict[str, int] = {}
        self._lock, number = claim(path, resume=resume)
        self._tape = Tape(path, number, header, options)
        self._due = self._sync_due = time.monotonic()
        self._gather_ns = round(options.gather_s * NS)
        self._stopping = False
        self._wake, self._lull = Event(), Event()
        self.patient = False
        """Whether the recorder's work is due, and waits a little for a lull in the session's."""
        self._thread = Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- called by the session

    def add_stream(self, name: str, spec: StreamSpec, role: Role, first: int = 0, *, outline: bool = False) -> int:
        """Declare a stream; returns its number for `write`. `first` is the cumulative index of the sample it starts with.

        Of an `outline`, only when samples came and how many is kept, not the samples.
        """
        if any(lane.name == name for lane in self._lanes):
            raise RecordingError(f"stream {name!r} is recorded already")
        kept: Kept = "outline" if outline else self._options.frames if is_frames(spec) else "whole"
        lane = Lane(name, spec, index=first, kept=kept, track=self._tape.declare(name, spec, role, kept))
        if kept in ("image", "packed"):
            lane.frames = self._tape.declare_frames(name, kept)
        if kept == "packed" and self._packer is None:
            self._packer = Packer()
        self._lanes.append(lane)
        self._share = self._limit // (len(self._lanes) - STREAMS)
        self._much = min(SPOOL_BYTES, self._share // 4)
        return len(self._lanes) - 1

    def write(self, stream: int, chunk: Chunk, arrival: int, sequence: int) -> None:
        """Hand over a chunk: its arrival (ns of session time) and its place in the input log. Its arrays are never written again."""
        lane = self._lanes[stream]
        if lane.kept == "outline":
            chunk = Chunk(chunk.time, NOTHING, chunk.until, chunk.lost)
        if lane.put - lane.got > self._much and not self._has_room(lane):
            lane.dropped += 1
            lane.missed += len(chunk.time)
            return
        lane.put += chunk.data.nbytes + OVERHEAD
        if arrival > self._latest:
            self._latest = arrival
        self._queue.put((stream, (chunk, arrival, sequence), lane.missed))
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
        self._queue.put((topic, (what, time, 0), 0))

    def _has_room(self, lane: Lane) -> bool:
        """Much of a stream waits: the recorder is woken; whether there is still room for more."""
        self._wake.set()
        return lane.put - lane.got <= self._share or not self._is_full() or self._wait_for_room()

    def _is_full(self) -> bool:
        return sum(lane.put - lane.got for lane in self._lanes) > self._limit

    def _wait_for_room(self) -> bool:
        """Offline, the writer waits; raises RecordingError where the disk refuses for some seconds."""
        well = time.monotonic()
        while self._wait and self._thread.is_alive() and self._is_full():
            now = time.monotonic()
            well = well if self._error else now
            if now - well > GRACE_S:
                raise self._incomplete()
            time.sleep(0.002)
        return self._wait and self._thread.is_alive()

    @property
    def part(self) -> int:
        """The number of the file that is being written."""
        return self._tape.number

    @property
    def status(self) -> RecorderStatus:
        return RecorderStatus(
            bytes=self._tape.saved,
            behind_s=max(self._latest - self._done, 0) / NS if self._latest else 0.0,
            dropped={lane.name: lost for lane in self._lanes if (lost := lane.dropped + lane.refused)},
            error=self._error,
        )

    def lull(self) -> None:
        """The session has nothing to do just now. The recorder's thread shares the interpreter with it, and works best in between."""
        self._lull.set()

    def flush(self, timeout_s: float = 5.0) -> bool:
        """Wait until everything handed over so far is on the disk itself; returns whether it is. Not for the graph's thread."""
        done = Event()
        self._queue.put((FLUSH, (done, 0, 0), 0))
        self._wake.set()
        return done.wait(timeout_s)

    def close(self) -> None:
        """Write what is left and the end, and wait for it; a disk that refuses is given up after some seconds."""
        self._stopping = True
        self._wake.set()
        self._thread.join()
        give_back(self._path, self._lock)

    def check(self) -> None:
        """Raises RecordingError where something that was handed over is not on the disk; for offline work, after `close`."""
        if self._error or self.status.dropped:
            raise self._incomplete()

    def _incomplete(self) -> RecordingError:
        why = self._error or "the disk was too slow"
        return RecordingError(
            f"{self._path}: not everything could be written ({why}); free some space or choose another folder"
        )

    # -- the recorder's thread

    def _run(self) -> None:
        ended = False
        try:
            while not self._stopping:
                self._wake.wait(0.01 if self._wait else self._options.flush_s * TURN)
                self._wake.clear()
                if not self._wait and not self._stopping:
                    self._await_lull()
                self._turn()
            self._turn(last=True)
            self._tape.finish()
            ended = True
        except OSError as error:
            self._fail(error)
        finally:
            if not ended:
                self._error = self._error or "the recorder has stopped"
                self._tape.abandon()

    def _await_lull(self) -> None:
        self._lull.clear()
        self.patient = True
        self._lull.wait(PATIENCE_S)
        self.patient = False

    def _turn(self, *, last: bool = False) -> None:
        """Take what has come, make messages of it, and write when it is time."""
        take, get = self._take, self._queue.get_nowait
        while True:
            try:
                number, what, missed = get()
            except Empty:
                break
            take(number, what, missed)
        if not self._wait or last:
            self._round()
        self._report_drops(over=last)
        now = time.monotonic()
        if not self._wait or last or now >= self._due:
            self._save()
            self._due = now + self._options.flush_s * TURN

    def _take(self, number: int, what: tuple[Any, int, int], missed: int) -> None:
        if number < STREAMS:
            self._take_other(number, what)
            return
        lane = self._lanes[number]
        chunk, arrival, _ = what
        if arrival > self._newest:
            self._newest = arrival
        now = self._newest
        if not self._gathered:
            self._opened = now
            self._done = self._done or arrival  # until something is on the disk, all since the first chunk is behind
        elif now - self._opened >= self._gather_ns or self._gathered > ROUND_BYTES:
            self._round()
            self._opened = now
        if missed:
            self._message(number)
            lane.index += missed
        pending = lane.pending
        if not pending:
            lane.first = lane.index
        pending.append(what)
        lane.index += len(chunk.time)
        size = chunk.data.nbytes + OVERHEAD
        lane.got += size
        self._gathered += size

    def _take_other(self, number: int, what: tuple[Any, int, int]) -> None:
        """A line of the log, the metrics, or a wish that everything be written now."""
        content, arrival, _ = what
        if number == FLUSH:
            self._round()
            self._sync_due = 0.0
            self._save()
            content.set()
            return
        self._lanes[number].got += OVERHEAD
        body = dump({"time": arrival, "table": content}) if number else encode_log(content[0], arrival, content[1])
        self._tape.add(number, arrival, arrival, self._batch, body)

    def _round(self) -> None:
        """Make one message per stream of what was gathered; all of them bear one batch number, so that readers can sort them."""
        if not self._gathered:
            return
        for number in range(STREAMS, len(self._lanes)):
            self._message(number)
        self._gathered = 0
        self._batch += 1
        if self._tape.waiting > SPOOL_BYTES:
            self._save()

    def _message(self, number: int) -> None:
        lane = self._lanes[number]
        if not lane.pending or lane.spec is None:
            return
        entries, lane.pending = lane.pending, []
        try:
            body = encode(lane.spec, entries, lane.first, lane.kept)
        except (ValueError, TypeError) as error:
            log.error("a chunk could not be recorded", stream=lane.name, error=str(error))
            self._note("not recorded", level="error", stream=lane.name, error=str(error))
            lane.refused += len(entries)
            return
        chunk, arrival, _ = entries[0]
        stamp = int(chunk.time[0]) if len(chunk.time) else arrival
        if lane.frames:
            self._frames(lane, entries)
        self._tape.add(lane.track, entries[-1][1] or self._newest, stamp, self._batch, body)

    def _frames(self, lane: Lane, entries: Sequence[Logged]) -> None:
        """Frames go before the table of their chunks."""
        index = lane.first
        for chunk, arrival, _ in entries:
            for stamp, frame in zip(chunk.time.tolist(), chunk.data, strict=True):
                packer = self._packer if lane.kept == "packed" else None
                body = packer.pack(index, stamp, frame) if packer else encode_image(stamp, index, frame)
                self._tape.add(lane.frames, arrival or self._newest, stamp, self._batch, body)
                index += 1

    def _save(self) -> None:
        """Write everything, however long it takes; while the disk refuses, the queue fills, and then the session's chunks are dropped."""
        since, pause = time.monotonic(), 0.1
        while True:
            now = time.monotonic()
            try:
                self._tape.save(sync=now >= self._sync_due)
                break
            except OSError as error:
                self._fail(error)
                if self._stopping and now > since + GRACE_S:
                    raise
            time.sleep(min(pause, 0.1) if self._stopping else pause)
            pause = min(pause * 1.5, 5.0)
        self._sync_due = now + SYNC_S if now >= self._sync_due else self._sync_due
        self._done = self._latest if self._queue.empty() else self._opened
        if self._error:
            waited = round(time.monotonic() - since, 1)
            log.warning("recording goes on", path=str(self._path), waited_s=waited, after=self._error)
            self._note("disk refused", level="warning", error=self._error, waited_s=waited)
            self._error = ""

    # -- what goes wrong

    def _note(self, kind: str, **facts: Any) -> None:
        """The recorder's own line in the session's log."""
        self._tape.add(0, self._latest, self._latest, self._batch, encode_log(kind, self._latest, facts))

    def _fail(self, error: OSError) -> None:
        text = error.strerror or str(error)
        if not self._error:
            goes_on = "" if self._wait else "; the session goes on"
            log.error(f"the recording cannot be written{goes_on}", path=str(self._path), error=text)
        self._error = text

    def _report_drops(self, *, over: bool) -> None:
        """Say once when chunks begin to be dropped; write into the session's log, when it is over, how many there were."""
        dropped = {lane.name: lane.dropped for lane in self._lanes if lane.dropped}
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
