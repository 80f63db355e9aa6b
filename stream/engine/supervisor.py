"""A source under supervision: read in its own thread, reopened with growing pauses when it fails or falls silent, its gaps marked."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, Literal, TypeAlias

import numpy as np
import structlog

from stream.chunk import FOREVER, NS, STAMP, Chunk, empty, utc
from stream.engine.channel import Channel, Doorbell
from stream.engine.clock import SessionClock
from stream.engine.promise import PromiseError, impossible
from stream.errors import DeviceError, KinegraphError, RunError, explain, nearest
from stream.graph import Edge, Node
from stream.source import Source

FIRST_PAUSE_S = 0.25
LONGEST_PAUSE_S = 10.0
STEADY_S = 10.0
"""A source that ran for so long is given the first pause again."""
UNAWAITED_S = 60.0
"""A source that only listens for words need not say more often that there was none, where nobody waits for it."""
GRACE_S = 2.0
"""How long a source that must stop may take before its thread is given up."""

State = Literal["starting", "running", "failed", "ended", "stopped"]
Report = Callable[..., None]
"""report(kind, **facts): something that belongs into the log and the recording."""
Door: TypeAlias = Callable[[Chunk], bool]
"""Whether a chunk has gone into the graph and all that it leads to is done; else nothing has been done."""

log = structlog.get_logger(__name__)


REST_S = 0.5
"""A source that nothing is the matter with is looked at so often, any other more often."""


def closed(chunk: Chunk) -> bool:
    """The door of a source that nobody has opened a graph for."""
    return False


class _StopReadingError(Exception):
    """Raised by `emit` in the thread of a source that has been given up."""


class _Feed:
    """One opening of a source; a source that is opened again gets a new one."""

    def __init__(self, runner: Runner, again: bool) -> None:
        self._runner = runner
        self._stop = threading.Event()
        self._over = False
        self.again = again
        self._unmarked = set(runner.channels) if again else set()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def stop(self) -> None:
        self._over = True
        self._stop.set()
        self._runner.mailbox.put(None)  # whoever waits for a word wakes

    def now(self) -> int:
        return self._runner.clock.now()

    def wait(self, seconds: float) -> bool:
        return self._stop.wait(seconds)

    def ready(self) -> None:
        self._runner.last_alive = time.monotonic()
        self._runner.came_alive()

    def hear(self, timeout_s: float) -> str | None:
        try:
            return self._runner.mailbox.get(timeout=timeout_s if self._runner.awaited else max(timeout_s, UNAWAITED_S))
        except Empty:
            return None

    def identify(self, device: str, **facts: str | float) -> None:
        self._runner.report("device", node=self._runner.node.name, device=device, **facts)

    def problem(self, kind: str, count: int = 1) -> None:
        self._runner.problems[kind] += count

    def tell(self, kind: str, **facts: str | float) -> None:
        self._runner.report(kind, node=self._runner.node.name, **facts)

    def device_clock(self, **facts: float) -> None:
        self._runner.clock_facts = facts

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        if self._over:
            raise _StopReadingError
        if self._unmarked or not self._runner.doors.get(output, closed)(chunk):
            self._queue(chunk, output)

    def _queue(self, chunk: Chunk, output: str) -> None:
        """The long way: the chunk is put in order and waits for the graph's thread."""
        now = time.monotonic_ns()
        runner = self._runner
        chunk = runner.normal(chunk, output)
        if len(chunk.time) and output in self._unmarked:
            self._unmarked.discard(output)
            chunk.lost = chunk.lost or -1
        runner.last_alive = now / NS
        runner.came_alive()
        runner.channels[output].put(chunk, runner.clock.at(now))


class Runner:
    """A source node at work.

    channels   per output, the queue to the graph's thread
    doors      per output, the short way past it
    awaited    whether anybody waits for what this source says
    problems   what the source counted, by kind
    clock_facts   what it said last of its device's clock
    openings   how often the source was opened
    """

    def __init__(
        self, node: Node, bell: Doorbell, clock: SessionClock, report: Report, fatal: Callable[[Exception], None]
    ) -> None:
        """`fatal` is told of what ends the run, not only this opening of the source: a queue that must not fill is full."""
        assert isinstance(node.part, Source)
        self.node, self.clock, self.report, self._fatal = node, clock, report, fatal
        self.source: Source = node.part.fresh()
        options = node.options
        self.channels = {
            output: Channel(str(Edge(node.name, output)), bell, options.queue, options.policy or "block")
            for output in node.specs
        }
        self.doors: dict[str, Door] = dict.fromkeys(node.specs, closed)
        self.awaited = True
        self.mailbox: SimpleQueue[str | None] = SimpleQueue()
        self.problems: Counter[str] = Counter()
        self.clock_facts: dict[str, float] = {}
        self.state: State = "starting"
        self.ready = False
        self.error = ""
        self.openings = 0
        self.last_alive = time.monotonic()
        self._opened = 0.0
        self._retry_at = 0.0
        self._pause_s = FIRST_PAUSE_S
        self._absent = False
        self._feed: _Feed | None = None
        self._thread: threading.Thread | None = None

    def start(self, again: bool = False) -> None:
        """Open the source in a new thread; `again` marks its first samples as coming after a gap."""
        self.openings += 1
        self.state = "running" if self.ready else "starting"
        self._opened = self.last_alive = time.monotonic()
        self._feed = _Feed(self, again or self.openings > 1)
        self._thread = threading.Thread(
            target=self._work, args=(self._feed,), name=f"source {self.node.name}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Tell the source to stop and let go a blocked write; `join` waits for it."""
        if self.state not in ("ended",):
            self.state = "stopped"
        if self._feed:
            self._feed.stop()
        for channel in self.channels.values():
            channel.close()

    def join(self, timeout_s: float = GRACE_S) -> bool:
        """Wait until the source's thread has ended; returns whether it has."""
        if self._thread:
            self._thread.join(timeout_s)
            return not self._thread.is_alive()
        return True

    def watch(self) -> None:
        """Called several times a second: reopen what failed, give up what fell silent."""
        now = time.monotonic()
        dead = (
            self._thread is not None and not self._thread.is_alive()
        )  # asked first: a thread sets its state before it ends
        if self.state == "failed" and self._is_due(now):
            if self._thread and self._thread.is_alive():
                if now < self._retry_at + GRACE_S:
                    return
                log.warning("source does not stop; its thread is given up", node=self.node.name)
            self.report("source reopened", node=self.node.name, opening=self.openings + 1)
            self.start()
        elif self.state in ("starting", "running") and 0 < self.node.options.silence_s < now - self.last_alive:
            if any(channel.waiting for channel in self.channels.values()):
                return  # not the source is silent, but the graph behind
            assert self._feed
            self._feed.stop()
            self._failed(f"silent for {now - self.last_alive:.1f} s")
        elif dead and self.state in ("starting", "running"):
            self._failed("its thread has ended without a word")

    def _is_due(self, now: float) -> bool:
        """Whether a source that failed is to be opened: never while its device is not there, at once when it has come back."""
        there = self.source.present()
        if there is False:
            self._absent = True
            return False
        if self._absent and there:
            self._absent, self._pause_s, self._retry_at = False, FIRST_PAUSE_S, now
        return now >= self._retry_at

    def at_ease(self, now: float) -> bool:
        """Whether nothing becomes due within `REST_S`."""
        silence_s = self.node.options.silence_s
        return self.state not in ("starting", "failed") and not 0 < silence_s < now - self.last_alive + REST_S

    def came_alive(self) -> None:
        """The device is there."""
        if not self.ready or self.state == "starting":
            self.ready = True
            if self.state == "starting":
                self.state = "running"

    def tidy(self, chunk: Chunk, output: str) -> Chunk:
        """The chunk in the arrays that operators expect: declared shape and dtype, contiguous, writable. Raises DeviceError."""
        if output not in self.node.specs:
            raise DeviceError(
                f"source {self.node.name!r} gave samples for an output {output!r}, which it has not: {nearest(output, self.node.specs)}"
            )
        spec = self.node.specs[output]
        times = np.require(chunk.time, STAMP, ["C", "A", "W"])
        data = np.require(chunk.data, spec.dtype, ["C", "A", "W"])
        if data.shape != (len(times), *spec.shape):
            raise DeviceError(
                f"source {self.node.name!r} gave samples of shape {data.shape[1:]}; its spec says {spec.shape}"
            )
        return Chunk(times, data, chunk.until, chunk.lost)

    def normal(self, chunk: Chunk, output: str) -> Chunk:
        """The chunk as operators expect it: tidy, times not decreasing, complete up to its last sample."""
        chunk = self.tidy(chunk, output)
        if what := impossible(chunk):
            raise PromiseError(self.node.name, output, what, chunk, kind="source")
        if (chunk.time[1:] < chunk.time[:-1]).any():
            chunk.time, chunk.data = self._in_order(chunk.time, chunk.data)
        if len(chunk.time):
            chunk.until = max(chunk.until, int(chunk.time[-1]))
        return chunk

    def _in_order(self, times: Any, data: Any) -> tuple[Any, Any]:
        keep = times >= np.maximum.accumulate(times)
        self.problems["time ran backwards"] += int((~keep).sum())
        self.report("time ran backwards", node=self.node.name, samples=int((~keep).sum()), at=utc(int(times[~keep][0])))
        return np.ascontiguousarray(times[keep]), np.ascontiguousarray(data[keep])

    def _work(self, feed: _Feed) -> None:
        try:
            self.source.read(feed)
            if not feed.stopped:
                self._end()
        except _StopReadingError:
            pass
        except RunError as error:
            self._fatal(error)
        except KinegraphError as error:
            if not feed.stopped:
                self._failed(str(error))
        except OSError as error:
            if not feed.stopped:
                self._failed(f"{type(error).__name__}: {error}")
        except Exception as error:
            if not feed.stopped:
                log.debug("source failed", node=self.node.name, exc_info=True)
                self._failed(explain(error))

    def _end(self) -> None:
        self.ready = True
        self.state = "ended"
        self.report("source ended", node=self.node.name)
        for output, channel in self.channels.items():
            channel.put(empty(self.node.specs[output], FOREVER), self.clock.now())

    def _failed(self, error: str) -> None:
        now = time.monotonic()
        if now - self._opened > STEADY_S:
            self._pause_s = FIRST_PAUSE_S
        self.error = error
        self._retry_at = now + self._pause_s
        self.state = "failed"
        self.report("source failed", node=self.node.name, error=error, retry_in_s=self._pause_s)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
