"""A source under supervision: read in its own thread, reopened with growing pauses when it fails or falls silent, its gaps marked."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Generic, Literal, TypeAlias, TypeVar

import structlog

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, empty
from kinegraph.stream.domain.claims import ClaimGate
from kinegraph.stream.domain.finding import REPORT, Finding
from kinegraph.stream.domain.rotation import RotationSigns, rotations
from kinegraph.stream.engine.flow.admission import conform, ordered, soundness
from kinegraph.stream.engine.flow.promise import END, MAX_LOST, PromiseError, impossible
from kinegraph.stream.engine.flow.queues import BoundedQueue, ReadyQueue
from kinegraph.stream.errors import (
    DeclarationError,
    DeviceError,
    KinegraphError,
    RunError,
    blaming,
    explain,
    nearest,
)
from kinegraph.stream.graph import Edge, Node, policy_of
from kinegraph.stream.graph.backpressure import max_bytes
from kinegraph.stream.source import Source
from kinegraph.stream.system.clock import SessionClock

FIRST_PAUSE_S = 0.25
LONGEST_PAUSE_S = 10.0
STEADY_S = 10.0
"""A source that ran for this long is given the first pause again."""
UNAWAITED_S = 60.0
"""How often a source that only listens for typed words emits an empty chunk, if no reader waits for it."""
GRACE_S = 2.0
"""How long a source that must stop may take before its thread is given up."""
FIRST_WORDS_S = 1.0
"""How long data that can wait do so for what background sources say at their start."""
REST_S = 0.5
"""How often a source that works is looked at; any other more often."""

State = Literal["starting", "running", "failed", "ended", "stopped"]
Event = Literal["open", "open again", "alive", "returned", "failed", "stop"]
TRANSITIONS: dict[State, dict[Event, State]] = {
    "starting": {
        "open": "starting",
        "open again": "running",
        "alive": "running",
        "returned": "ended",
        "failed": "failed",
        "stop": "stopped",
    },
    "running": {"returned": "ended", "failed": "failed", "stop": "stopped"},
    "failed": {"open": "starting", "open again": "running", "returned": "ended", "failed": "failed", "stop": "stopped"},
    "ended": {},
    "stopped": {"returned": "ended"},
}
"""What becomes of a source's state; an event that is not listed changes nothing. "open again": it was ready before."""

Report = Callable[..., None]
"""report(kind, **facts): something that belongs into the log and the recording."""
Inline: TypeAlias = Callable[[Chunk, int], bool]
"""Takes a chunk and when it came (ns of the host's monotonic clock). Whether it needs no queue: it has gone into the graph, or is gathered
for it; else nothing has been done."""
P = TypeVar("P")

log = structlog.get_logger(__name__)


def not_inline(chunk: Chunk, came: int) -> bool:
    """The inline way of a source that no graph reads yet."""
    return False


class _StopReadingError(Exception):
    """Raised by `emit` in the thread of a source that has been given up."""


class _Feed:
    """One opening of a source; a source that is opened again gets a new one."""

    def __init__(self, supervisor: SourceSupervisor, again: bool) -> None:
        self._supervisor = supervisor
        self._stop = threading.Event()
        self._over = False
        self.again = again
        self._unmarked = set(supervisor.queues) if again and not supervisor.source.continues else set()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def stop(self) -> None:
        self._over = True
        self._stop.set()
        self._supervisor.mailbox.put(None)  # whoever waits for a word wakes

    def now(self) -> int:
        return self._supervisor.now()

    def wait(self, seconds: float) -> bool:
        return self._stop.wait(seconds)

    def ready(self) -> None:
        self._supervisor.last_alive = time.monotonic()
        self._supervisor.came_alive()

    def listen(self, timeout_s: float) -> str | None:
        try:
            only_listens = timeout_s > 0 and not self._supervisor.has_readers
            return self._supervisor.mailbox.get(timeout=max(timeout_s, UNAWAITED_S) if only_listens else timeout_s)
        except Empty:
            return None

    def identify(self, device: str, **facts: str | float) -> None:
        self._supervisor.report("device", node=self._supervisor.node.name, device=device, **facts)

    def problem(self, kind: str, count: int = 1) -> None:
        self._supervisor.problems[kind] += count

    def tell(self, kind: str, **facts: str | float) -> None:
        if kind == REPORT:
            self._supervisor.find(Finding.from_facts(facts))
        else:
            self._supervisor.report(kind, node=self._supervisor.node.name, **facts)

    def device_clock(self, **facts: float) -> None:
        self._supervisor.clock_facts = facts

    def position(self, output: str = "out") -> int:
        return self._supervisor.position(output)

    def saved(self) -> int:
        return self._supervisor.saved()

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        # the only way to end a driver that does not look at `stopped`: its next emit raises in its own thread
        if self._over:
            raise _StopReadingError
        supervisor = self._supervisor
        now = time.monotonic_ns()
        sound = supervisor.sound.get(output)
        if sound is None or not sound(chunk):
            chunk = supervisor.mended(chunk, output)
        # after the gate, which judges what the sender sent, and before any reader
        if output in supervisor.turned:
            chunk = Chunk(chunk.time, supervisor.turned[output].of(chunk.data), chunk.until, chunk.lost)
        # what was missed while the source was closed is of unknown number, whatever the driver thinks
        if self._unmarked and len(chunk.time) and output in self._unmarked:
            self._unmarked.discard(output)
            chunk.lost = chunk.lost or -1
        supervisor.last_alive = now / NS
        if supervisor.state == "starting" and not supervisor.source.background:
            supervisor.came_alive()
        if not supervisor.inline[output](chunk, now):
            supervisor.queues[output].put(chunk, supervisor.clock.at(now))
        if supervisor.state == "starting":  # only now, so that data which waited for its first word come behind it
            supervisor.came_alive()


class SourceSupervisor:
    """A source node at work.

    queues     per output, the queue to the graph's thread
    inline     per output, the way into the graph without it
    gates      per output, what compares its claims with what arrives
    turned     per output with rotations, what makes their signs continuous
    findings   claims that do not hold, in the order in which they were found
    sound      per output, what tells whether a chunk can be taken as it is
    has_readers whether anybody waits for what this source says
    now        session time, as the source sees it
    live       whether its data are lost if they are not read
    problems   what the source counted, by kind
    clock_facts   its last report on its device's clock
    openings   how often the source was opened
    position, saved   what `Feed` asks
    """

    def __init__(
        self, node: Node, ready: ReadyQueue, clock: SessionClock, report: Report, fatal: Callable[[Exception], None]
    ) -> None:
        """`fatal` receives what ends the run, not only this opening of the source: a queue that must not fill is full."""
        assert isinstance(node.part, Source)
        self.node, self.clock, self.report, self._fatal = node, clock, report, fatal
        with blaming(node.name, "fresh"):
            self.source: Source = node.part.unopened()
            self.live = self.source.live
        options, policy = node.options, policy_of(node, live=self.live)
        bound = max_bytes(policy, live=self.live)
        self.queues = {
            output: BoundedQueue(str(Edge(node.name, output)), ready, options.queue, policy, bound=bound)
            for output in node.specs
        }
        self.inline: dict[str, Inline] = dict.fromkeys(node.specs, not_inline)
        self.gates = {
            output: ClaimGate(str(Edge(node.name, output)), spec, wrong=self.source.rate_tolerance)
            for output, spec in node.specs.items()
        }
        self.sound = {output: soundness(spec, self.gates[output]) for output, spec in node.specs.items()}
        self.turned = {
            output: RotationSigns(starts) for output, spec in node.specs.items() if (starts := rotations(spec))
        }
        self.findings: list[Finding] = []
        self.has_readers = True
        self.position: Callable[[str], int] = lambda output: NEVER
        self.saved: Callable[[], int] = lambda: FOREVER
        self.now: Callable[[], int] = clock.now
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
        self._absent = self._refused = False
        self._feed: _Feed | None = None
        self._thread: threading.Thread | None = None

    @property
    def down(self) -> bool:
        """Whether it is missing at the end of a session: failed, or nothing good has come of it, but errors or what was bad.

        A source that is not required may stay away altogether.
        """
        if not self.ready and not self.node.options.required:
            return False
        return self.state == "failed" or (not self.ready and bool(self.error or self.problems))

    def start(self, again: bool = False) -> None:
        """Open the source in a new thread; `again` marks its first samples as coming after a gap."""
        self.openings += 1
        self.on("open again" if self.ready else "open")
        self._opened = self.last_alive = time.monotonic()
        self._feed = _Feed(self, again or self.openings > 1)
        self._thread = threading.Thread(
            target=self._work, args=(self._feed,), name=f"source {self.node.name}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Ask the source to stop, and release a blocked write; `join` waits for it."""
        self.on("stop")
        if self._feed:
            self._feed.stop()
        for queue in self.queues.values():
            queue.close()

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
                log.warning("source does not stop; its thread is abandoned", node=self.node.name)
            self.report("source reopened", node=self.node.name, opening=self.openings + 1)
            self.start()
        elif self.state in ("starting", "running") and 0 < self.node.options.silence_s < now - self.last_alive:
            if any(queue.depth for queue in self.queues.values()):
                return  # not the source is silent, but the graph behind
            assert self._feed
            self._feed.stop()
            self._failed(f"silent for {now - self.last_alive:.1f} s")
        elif dead and self.state in ("starting", "running"):
            self._failed("its thread has ended without a word")

    def _is_due(self, now: float) -> bool:
        """Whether a source that failed is to be opened: never while its device is not there, at once when it has come back."""
        if self._refused:
            return False
        with blaming(self.node.name, "present"):
            there = self.source.present()
        if there is False:
            self._absent = True
            return False
        # plugged in again: somebody is waiting for it, so the pause of earlier failures is over
        if self._absent and there:
            self._absent, self._pause_s, self._retry_at = False, FIRST_PAUSE_S, now
        return now >= self._retry_at

    def is_idle(self, now: float) -> bool:
        """Whether nothing becomes due within `REST_S`."""
        silence_s = self.node.options.silence_s
        return self.state not in ("starting", "failed") and not 0 < silence_s < now - self.last_alive + REST_S

    def on(self, event: Event) -> None:
        """Something has happened to the source: TRANSITIONS says what state it is in now."""
        self.state = TRANSITIONS[self.state].get(event, self.state)

    def came_alive(self) -> None:
        """The device is there."""
        self.ready = True
        self.on("alive")

    def mended(self, chunk: Chunk, output: str) -> Chunk:
        """A chunk that is not sound, as the graph can take it: declared shape and dtype, times in order. Raises DeviceError, or
        PromiseError for times that cannot be."""
        spec = self.node.specs.get(output)
        if spec is None:
            raise DeviceError(
                f"source {self.node.name!r} gave samples for an output {output!r} that it does not have: {nearest(output, self.node.specs)}"
            )
        gate = self.gates[output]
        chunk = conform(spec, chunk)
        time, data = chunk.time, chunk.data
        if data.shape != (len(time), *spec.shape):
            raise DeviceError(
                f"source {self.node.name!r} gave samples of shape {data.shape[1:]}; its spec says {spec.shape}"
            )
        before, until = chunk, chunk.until
        chunk, dropped = ordered(chunk)
        if dropped:
            self.problems["time ran backwards"] += dropped
            at = next(b for a, b in zip(time.tolist(), time[1:].tolist(), strict=False) if b < a)
            gate.ran_backwards(dropped, at)
        if not (until < END and chunk.until < END and -1 <= chunk.lost <= MAX_LOST) or (
            len(time) and time.item(0) <= -END
        ):
            raise PromiseError(self.node.name, output, impossible(before), before, kind="source")
        gate.see(chunk)
        return chunk

    def look(self, *, over: bool = False) -> None:
        """Report what is new of claims that do not hold. Raises DeclarationError where that ends the session."""
        for gate in self.gates.values():
            for finding in gate.look(over=over):
                if not any(known.kind == finding.kind for known in self.findings):
                    try:
                        self.find(finding)
                    except DeclarationError as error:
                        if self.node.options.required:
                            raise
                        self._give_up(str(error))

    def find(self, finding: Finding) -> None:
        """A claim does not hold. Raises DeclarationError where that ends the session."""
        self.findings.append(finding)
        self.report(REPORT, node=self.node.name, **finding.facts())
        if self.node.options.claims == "refuse" or finding.kind in self.source.refuses:
            raise DeclarationError(
                f"source {self.node.name!r} is not as declared: {finding.text}; `claims: warn` goes on"
            )

    def _give_up(self, error: str) -> None:
        """An optional source that is refused is closed and stays so; the session goes on."""
        self._refused = True
        if self._feed:
            self._feed.stop()
        self._failed(error)

    def _work(self, feed: _Feed) -> None:
        try:
            self.source.read(feed)
            if not feed.stopped:
                self._end()
        except _StopReadingError:
            pass
        except DeclarationError as error:
            if self.node.options.required:
                self._fatal(error)
            elif not feed.stopped:
                self._failed(str(error))
        except RunError as error:
            self._fatal(error)
        except KinegraphError as error:
            if not feed.stopped:
                self._failed(str(error))
        except OSError as error:
            if not feed.stopped:
                self._failed(f"{type(error).__name__}: {error}")
        except BaseException as error:  # also SystemExit, of which a thread would die in silence
            if not feed.stopped:
                log.debug("source failed", node=self.node.name, exc_info=True)
                self._failed(explain(error))

    def _end(self) -> None:
        self.ready = True
        self.on("returned")
        self.report("source ended", node=self.node.name)
        for output, queue in self.queues.items():
            queue.put(empty(self.node.specs[output], FOREVER), self.clock.now())

    def _failed(self, error: str) -> None:
        now = time.monotonic()
        # it ran well for a while: this failure is a new one, and is retried soon
        if now - self._opened > STEADY_S:
            self._pause_s = FIRST_PAUSE_S
        self.error = error
        self._retry_at = now + self._pause_s
        self.on("failed")
        self.report("source failed", node=self.node.name, error=error, retry_in_s=self._pause_s)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)


class StartBarrier(Generic[P]):
    """No sample passes until every required source is ready. What a live device sends before is left out; files and people wait instead.

    since   when that was (monotonic s), or when the waiting began
    """

    def __init__(self, supervisors: Sequence[SourceSupervisor], followers: Sequence[SourceSupervisor] = ()) -> None:
        """`followers` say what they have to say at first before any data enter; they are not waited for longer than `FIRST_WORDS_S`."""
        self._followers = followers
        self._required = [r for r in supervisors if r.node.options.required and not r.source.background]
        self._held: list[tuple[P, Chunk, int]] = []
        self._began = self.since = time.monotonic()
        self.done = False

    def excuse(self, known: Sequence[SourceSupervisor]) -> None:
        """Sources that were there before a session was broken off: the others go on at once, as when a cable is pulled meanwhile."""
        self._required = [r for r in self._required if r not in known]

    def begin(self) -> None:
        """The sources are started now."""
        self._began = self.since = time.monotonic()

    def pass_on(self, port: P, supervisor: SourceSupervisor, chunk: Chunk, arrival: int) -> list[tuple[P, Chunk, int]]:
        """What may enter now that this chunk has come: it and all that was held, or nothing yet."""
        if self.done:
            return [(port, chunk, arrival)]
        source = supervisor.source
        # a live device's samples of before the start are left out, but files would lose their beginning for good; and a source that has
        # ended already will not say so again
        if self.ready or source.background or not supervisor.live or chunk.until == FOREVER:
            self._held.append((port, chunk, arrival))
        return self.release()

    def release(self) -> list[tuple[P, Chunk, int]]:
        """What was held, once all required sources are ready."""
        if not self.ready:
            return []
        self.done = True
        self.since = time.monotonic()
        held, self._held = self._held, []
        return held

    @property
    def ready(self) -> bool:
        return all(r.ready for r in self._required) and all(map(self._has_spoken, self._followers))

    def _has_spoken(self, supervisor: SourceSupervisor) -> bool:
        """Whether what it says at its start, if anything, has come this far."""
        if supervisor.ready and not any(queue.depth for queue in supervisor.queues.values()):
            return True
        return supervisor.state in ("failed", "ended") or time.monotonic() - self._began > FIRST_WORDS_S

    def check_deadlines(self) -> None:
        """Raise DeviceError for a required source that is not ready in time."""
        waited = time.monotonic() - self._began
        for supervisor in self._required:
            deadline = supervisor.node.options.deadline_s
            if not supervisor.ready and waited > deadline:
                why = f": {supervisor.error}" if supervisor.error else ""
                raise DeviceError(
                    f"source {supervisor.node.name!r} delivered nothing within {deadline:g} s{why};"
                    " connect it, or set `required: false` or a longer `deadline_s`"
                )
