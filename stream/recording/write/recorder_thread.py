"""The recorder's thread: it takes what a session has handed over, between the session's own work, and has it written in time."""

from __future__ import annotations

import time
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, TypeAlias

from kinegraph.stream.recording.write.file_segments import FileSegments
from kinegraph.stream.recording.write.message_batches import MessageBatch, MessageBatches
from kinegraph.stream.recording.write.record_writer import RecordWriter
from kinegraph.stream.system.stalls import let_others_go_on

TURN = 0.8
"""This much of `flush_s` the recorder's thread sleeps, unless much comes; then it writes all that came."""
PATIENCE_S = 0.02
"""How long the recorder waits for a moment at which the session has nothing to do."""
Line: TypeAlias = tuple[int, Any, int]
"""A line of the log (0) or of the metrics (1), and its time (ns)."""
Handed: TypeAlias = MessageBatch | Line | Event
"""What waits for the thread; an event marks a place, and is set once all before it is on the disk."""


class RecorderThread:
    """
    live      a session goes on meanwhile: the thread sleeps most of `flush_s`, and then waits for a lull
    patient   whether its work is due, and waits a little for a lull in the session's
    """

    def __init__(
        self,
        queue: SimpleQueue[Handed],
        rounds: MessageBatches,
        writer: RecordWriter,
        segments: FileSegments,
        stop: Event,
        *,
        flush_s: float,
        live: bool,
    ) -> None:
        self._queue, self._rounds, self._writer, self._segments, self._stop = queue, rounds, writer, segments, stop
        self._turn_s, self._live = flush_s * TURN, live
        self._wake, self._lull = Event(), Event()
        self._due = time.monotonic()
        self.patient = False
        self._thread = Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def wake(self) -> None:
        """Much waits."""
        if not self._wake.is_set():
            self._wake.set()

    def idle_hint(self) -> None:
        """The session has nothing to do just now."""
        self._lull.set()

    def close(self) -> None:
        """Write what is left and the end, and wait for it."""
        self._stop.set()
        self._wake.set()
        self._thread.join()

    def _run(self) -> None:
        let_others_go_on()
        ended = False
        try:
            while not self._stop.is_set():
                self._wake.wait(self._turn_s if self._live else 0.01)
                self._wake.clear()
                if self._live and not self._stop.is_set():
                    self._await_lull()
                self._turn()
            self._turn(last=True)
            self._segments.finish()
            ended = True
        except OSError as error:
            self._writer.fail(error)
        finally:
            if not ended:
                self._writer.error = self._writer.error or "the recorder has stopped"
                self._segments.abandon()

    def _await_lull(self) -> None:
        self._lull.clear()
        self.patient = True
        self._lull.wait(PATIENCE_S)
        self.patient = False

    def _turn(self, *, last: bool = False) -> None:
        """Hand the writer what has come, and have it written when it is time."""
        writer, get, here = self._writer, self._queue.get_nowait, Event()
        if self._live or last:
            # a line of the log never gets to the disk before the chunks that it is about
            self._rounds.end(None if last else here)
        while True:
            try:
                item = get()
            except Empty:
                break
            if item is here:
                break
            if isinstance(item, MessageBatch):
                writer.take(item)
            elif isinstance(item, Event):
                writer.sync()
                item.set()
            else:
                writer.take_line(*item)
        writer.report_drops(over=last)
        now = time.monotonic()
        if self._live or last or now >= self._due:
            writer.save()
            self._due = now + self._turn_s
