"""Where sources' chunks enter the graph, one after the other: inline on the source's own thread, or through queues and one ready queue.

A chunk is worked through inline while nothing waits and no other thread has the turn: to wake another thread for it costs more than most
graphs' work. Chunks of a burst are gathered there, and enter as one. Everything else waits for the graph's thread. All ways end in
`Ingress.enter`, and what may enter is decided by `stream.engine.flow.admission` alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from queue import Empty
from threading import Lock
from time import perf_counter_ns
from typing import Any

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, empty, utc
from kinegraph.stream.engine.flow.admission import JOINED_BYTES, admit, followed
from kinegraph.stream.engine.flow.edge import CallSlot, LiveEdge
from kinegraph.stream.engine.flow.queues import BoundedQueue, ReadyQueue
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.session_log import PriorSession, SessionLog
from kinegraph.stream.engine.supervisor import REST_S, Inline, SourceSupervisor, StartBarrier
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.manual import Value
from kinegraph.stream.system.clock import SessionClock

LONG_AGO = 10**8 * NS
"""In 1973: a live sample's stamp that lies before is rather one in other units."""
LONG_NS = 1_000_000
LONG_OFTEN = 3
"""Work longer than LONG_NS this often in a row would keep a source from its device: for a second, its chunks are queued."""
BURST, SPARE_NS = 32, 50_000
GATHERED, GATHERED_NS, GATHERED_BYTES = 128, 2_000_000, 1 << 18
"""A live source that waits less than SPARE_NS a chunk for its device, over BURST chunks, has more at hand than is worked through one by
one. Up to GATHERED chunks and GATHERED_BYTES are gathered on its thread, for at most GATHERED_NS, and enter as one."""
PAUSES = 2
"""A source that has waited longer this often in a row gathers no more: one pause may be of its thread, not of its device."""
FOLLOWED_NS = 50_000_000
"""How far data may run ahead of what follows them: as far as they do in real time, where a value speaks every 50 ms."""


@dataclass(slots=True)
class GraphTurn:
    """Who works on the graph now.

    lock   one thread at a time
    open   whether sources may by themselves: after the common start, before the end
    """

    lock: Lock = field(default_factory=Lock)
    open: bool = False


@dataclass(slots=True)
class IngressPort:
    """One output of a source, as the graph sees it.

    number     its number in the input log
    watermark  the stream is complete up to this time; what comes later and is older is dropped
    last       when its last chunk came (monotonic s)
    late       samples dropped because they came too late
    pending_gap what is missing before the next sample, beyond what its chunk says
    has_readers whether an operator depends on this stream's watermark; if not, only samples enter
    checks_clock whether it is still to be seen to that stamps do not lie ahead of the session's clock
    follows    whether it is a background stream of a session without live sources
    gathers    whether its source gathers chunks
    may_join   whether chunks may enter together: when a file's do depends on the data alone
    """

    supervisor: SourceSupervisor
    output: str
    edge: LiveEdge
    number: int = -1
    watermark: int = NEVER
    last: float = field(default_factory=time.monotonic)
    late: int = 0
    pending_gap: int = 0
    silent: bool = False
    stale: bool = False
    follows: bool = False
    gathers: bool = False
    has_readers: bool = field(init=False)
    checks_clock: bool = field(init=False)
    may_join: bool = field(init=False)

    def __post_init__(self) -> None:
        self.has_readers, self.checks_clock = bool(self.edge.readers), self.supervisor.live
        self.may_join = self.supervisor.live and self.queue.policy == "block"
        self.queue.owner = self

    @property
    def queue(self) -> BoundedQueue:
        return self.supervisor.queues[self.output]

    @property
    def stream(self) -> str:
        return self.queue.name

    @property
    def ended(self) -> bool:
        return self.watermark == FOREVER

    @property
    def expects_data(self) -> bool:
        """Whether silence matters: not for typed annotations without a reader."""
        return not self.ended and (self.has_readers or not self.supervisor.source.background)

    def nothing_for(self, age_s: float, now: int, report: Callable[..., None]) -> Chunk | None:
        """At `now` (ns), nothing has come for `age_s`. Once that is longer than the stated patience: the chunk that says that nothing
        happened, so that readers do not wait; the alarm is raised after `stale_s`. What waits in the queue counts as arrived."""
        options = self.supervisor.node.options
        if not self.expects_data or self.queue.depth:
            return None
        if 0 < options.stale_s < age_s and not self.stale:
            self.stale = True
            report("stream is stale", stream=self.stream, age_s=round(age_s, 2))
        until = now - int(options.patience_s * NS)
        if self.supervisor.source.continues:
            return None
        if not self.has_readers or not 0 < options.patience_s < age_s or until <= self.watermark:
            return None
        if not self.silent:
            self.silent = True
            report("silent source advanced", stream=self.stream, to=utc(until))
        self.watermark = until
        return empty(self.edge.spec, until)

    def tell(self, chunk: Chunk, late: int, ahead_ns: int, report: Callable[..., None]) -> None:
        """Report samples that came too late; stamps that are ahead of the clock are a finding."""
        if ahead_ns:
            self.checks_clock = False
            self.supervisor.gates[self.output].is_ahead(ahead_ns, chunk.until)
        if late:
            self.late += late
            units = "stamps are nanoseconds since 1970, as Feed.now() gives them"
            other = {"hint": units} if chunk.time[-1] < LONG_AGO else {}
            report("late samples dropped", stream=self.stream, samples=late, at=utc(int(chunk.time[0])), **other)

    def is_idle(self, age_s: float) -> bool:
        """Whether nothing becomes due within `REST_S`, after nothing has come for `age_s`."""
        options = self.supervisor.node.options
        waits_s = (options.patience_s if self.has_readers else 0.0, 0.0 if self.stale else options.stale_s)
        return not self.expects_data or all(age_s + REST_S < wait_s for wait_s in waits_s if wait_s)


class DataTime:
    """Time in a session without live sources: the time of the data, which may run faster than the clock, or in another year.

    Background streams follow it: their samples are stamped with it, and whoever reads them beside data never waits for them longer than
    `FOLLOWED_NS` of data. What they say before the first data waits for these, to be stamped just before them.

    newest     up to when the data have come; NEVER: nothing has come yet
    followers  the background streams; empty: a source is live, and time is the clock's
    """

    __slots__ = ("_due", "_early", "clock", "followers", "newest")

    def __init__(self, ports: Sequence[IngressPort], clock: SessionClock) -> None:
        self.newest = self._due = NEVER
        self.clock = clock
        lasting = [port for port in ports if not port.supervisor.source.background]
        alone = bool(lasting) and not any(port.supervisor.live for port in lasting)
        self.followers = [port for port in ports if alone and port.supervisor.source.background]
        self._early: list[tuple[IngressPort, Chunk, int]] = []
        for port in self.followers:
            port.follows, port.checks_clock, port.supervisor.now = True, False, self.now

    def now(self) -> int:
        """The session's time: the data's where no source is live, else the clock's."""
        return self.newest if self.newest != NEVER else self.clock.now()

    def passes(self, port: IngressPort, until: int) -> bool:
        """Whether a chunk up to `until` enters alone: it is data, and no follower is due. Advances the time of the data."""
        if port.follows or until > self._due:
            return False
        if until > self.newest:
            self.newest = until
        return True

    def entering(self, port: IngressPort, chunk: Chunk, arrival: int) -> Iterator[tuple[IngressPort, Chunk, int]]:
        """What enters now that this chunk has come, in its order; each is taken in before the next is asked for."""
        until = chunk.until
        if port.follows:
            port.last = time.monotonic()
            if self.newest != NEVER:
                yield port, followed(chunk, port.watermark, self.newest), arrival
            elif len(chunk.time) or until == FOREVER:
                self._early.append((port, chunk, arrival))
            return
        if until != FOREVER and until > self._due:
            if self._early:
                yield from self.early(chunk.time.item(0) if len(chunk.time) else until)
            self._due = until + FOLLOWED_NS
            for follower in self.followers:
                if follower.has_readers and not follower.ended:
                    yield follower, empty(follower.edge.spec, until), arrival
        if until != FOREVER and until > self.newest:
            self.newest = until
        yield port, chunk, arrival

    def early(self, before: int) -> Iterator[tuple[IngressPort, Chunk, int]]:
        """Followers' chunks that arrived before the first data, stamped just `before` these, one after the other."""
        while self._early:
            port, chunk, arrival = self._early[0]
            yield port, followed(chunk, port.watermark, before - len(self._early)), arrival
            del self._early[0]


class Bursts:
    """The sources that gather chunks now: each on its own thread, until it has no more at hand, which the graph's thread sees.

    ports   of these sources
    """

    __slots__ = ("_lock", "_ready", "ports")

    def __init__(self, ready: ReadyQueue) -> None:
        self._ready, self._lock = ready, Lock()
        self.ports: list[IngressPort] = []

    def begin(self, port: IngressPort, gather: Inline) -> None:
        """From now on `gather` takes what the source gives; the graph's thread is woken to look after it."""
        with self._lock:
            port.gathers = True
            port.supervisor.inline[port.output] = gather
            if not any(port is other for other in self.ports):
                self.ports.append(port)
                self._ready.put(None)

    def over(self) -> Iterator[IngressPort]:
        """Those of which nothing has entered for GATHERED_NS, to enter what they have gathered; with nothing gathered, it is over."""
        quiet = time.monotonic() - GATHERED_NS / NS
        for port in self.ports[:]:
            if port.last < quiet and port.queue.gathered:
                yield port
            elif port.last < quiet:
                port.gathers = False
            with self._lock:  # what a source has added meanwhile it takes back itself (`gather`)
                if not port.gathers and not port.queue.gathered:
                    self.ports.remove(port)


class Ingress:
    """All that stands between the sources and the graph.

    ports   one per output of a source
    turn    who works on the graph now
    over    whether every source that a session lasts for has ended
    time    the session's
    bursts  the sources that gather chunks
    """

    def __init__(
        self,
        ready: ReadyQueue,
        supervisors: Sequence[SourceSupervisor],
        pipeline: Pipeline,
        session_log: SessionLog,
        clock: SessionClock,
        fail: Callable[[Exception], None],
    ) -> None:
        """`ready` holds what waits, also what workers send home; `fail` takes what operators raise on a source's thread."""
        self._ready, self._log, self._clock, self._fail = ready, session_log, clock, fail
        self._supervisors, self._slot = supervisors, pipeline.slots[""]
        self._put_aside: list[BoundedQueue] = []
        self.bursts = Bursts(ready)
        self._closed = self.over = False
        self.turn = GraphTurn()
        self.ports = [
            IngressPort(r, o, pipeline.entries[queue.name]) for r in supervisors for o, queue in r.queues.items()
        ]
        self.time = DataTime(self.ports, clock)
        self._start: StartBarrier[IngressPort] = StartBarrier(
            supervisors, [port.supervisor for port in self.time.followers]
        )
        for port in self.ports:
            port.queue.arrival_of = clock.at
            port.queue.on_drop = _dropped(session_log, port.stream)
            port.supervisor.inline[port.output] = self.inline(port)
        for supervisor in supervisors:
            supervisor.position, supervisor.saved = self._position(supervisor), session_log.saved
            supervisor.has_readers = any(port.has_readers for port in self.ports if port.supervisor is supervisor)

    def declare(self, prior: PriorSession | None) -> None:
        """Name the streams of the input log, and go on where a session was broken off."""
        for port in self.ports:
            recorded = prior.recorded(port.stream) if prior else 0
            port.number = self._log.add_input(port.stream, port.edge.spec, recorded)
            if prior and prior.checkpoint:
                port.watermark = prior.checkpoint.promised.get(port.stream, NEVER)
        if prior:
            self._start.excuse([port.supervisor for port in self.ports if prior.recorded(port.stream)])

    def _position(self, supervisor: SourceSupervisor) -> Callable[[str], int]:
        """Up to when the session has a source's outputs, with what waits in their queues."""
        ports = {port.output: port for port in self.ports if port.supervisor is supervisor}

        def position(output: str) -> int:
            port = ports[output]
            waiting = [item[0].until for item in port.queue.waiting] + [chunk.until for chunk, _ in port.queue.gathered]
            return int(max([port.watermark, *waiting]))

        return position

    def tell(self, node: str, text: str) -> None:
        """Give a source what a person typed for it; raises KinegraphError if it cannot be."""
        for supervisor in self._supervisors:
            if supervisor.node.name == node:
                if isinstance(supervisor.source, Value):
                    supervisor.source.accepts(text)
                supervisor.mailbox.put(text)
                return
        raise KinegraphError(f"there is no source {node!r} to tell {text!r}")

    def begin(self) -> None:
        """The sources are started now: from now on it counts how long they take."""
        self._start.begin()

    def close(self) -> None:
        """No source goes in by itself any more; what waits can still be served."""
        self._closed, self.turn.open = True, False

    # the ways in -------------------------------------------------------------------------------------------------------

    def inline(self, port: IngressPort) -> Inline:
        """The way into the graph on the source's own thread."""
        return _inline(self, port, self._ready, self._slot, self._log, self._fail)

    def serve(self, timeout_s: float) -> None:
        """Take the next chunk that waits, whoever it comes from, or all of a live source's if they are many; waits at most `timeout_s`."""
        if self.bursts.ports:
            for port in self.bursts.over():
                with self.turn.lock:
                    self.enter_together(port)
                    self._slot.port = None
            # a source that falls silent in a burst leaves chunks behind that nobody else would bring in
            timeout_s = min(timeout_s, GATHERED_NS / NS)
        if self._put_aside:
            queue = self._put_aside.pop(0)
        else:
            try:
                token = self._ready.get(timeout=timeout_s)
            except Empty:
                return
            if not isinstance(token, BoundedQueue):
                return
            queue = token
        port = queue.owner
        with self.turn.lock:
            # many wait: joined they cost one pass through the graph instead of one each
            if len(queue.waiting) >= BURST and isinstance(port, IngressPort) and port.may_join and self._start.done:
                self.enter_together(port)
            elif (item := queue.take()) is None:
                return
            elif not isinstance(port, IngressPort):
                port(item[0], perf_counter_ns())
            elif self._start.done:
                self.enter(port, *item)
            else:
                self._let_in(self._start.pass_on(port, port.supervisor, *item))
            self._slot.port = None

    def enter_together(self, port: IngressPort) -> int:
        """On the graph's turn, what a source has left in its queue and gathered enters; returns how many ns that took."""
        return sum(self.enter(port, *taken) for taken in port.queue.take_together())

    def enter(self, port: IngressPort, chunk: Chunk, arrival: int, joined: bool = False) -> int:
        """A source's chunk, or several `joined`, enters the graph, as far as it is admitted: how many ns all that it leads to took."""
        # the usual case first: no generator is made for a chunk that enters alone
        if not self.time.followers or self.time.passes(port, chunk.until):
            return self._admit(port, chunk, arrival, joined)
        return sum(self._admit(*entry) for entry in self.time.entering(port, chunk, arrival))

    def _admit(self, port: IngressPort, chunk: Chunk, arrival: int, joined: bool = False) -> int:
        verdict = admit(
            chunk,
            port.watermark,
            port.pending_gap,
            arrival,
            has_readers=port.has_readers,
            checks_clock=port.checks_clock,
        )
        port.last = time.monotonic()
        port.silent = port.stale = False
        if verdict.late or verdict.ahead_ns:
            port.tell(chunk, verdict.late, verdict.ahead_ns, self._log.report)
        admitted = verdict.chunk
        if admitted is None:
            return 0
        if len(admitted.time):
            port.pending_gap = 0
        port.watermark = admitted.until
        self._log.enter(port.number, admitted, arrival, joined)
        start = perf_counter_ns()
        end = port.edge.send(admitted, start)
        if admitted.until == FOREVER:
            lasting = [p for p in self.ports if not p.supervisor.source.background]
            self.over = bool(lasting) and all(p.ended for p in lasting)
        return end - start

    # what else comes and does not come -----------------------------------------------------------------------------------

    def serve_all(self) -> None:
        """Work through everything that waits."""
        for port in self.ports:
            if port.queue.gathered:
                self.enter_together(port)
        while not self._ready.empty() or self._put_aside:
            self.serve(0.0)

    def _let_in(self, held: list[tuple[IngressPort, Chunk, int]]) -> None:
        """What may enter before and at the common start; from then on sources enter by themselves."""
        for entry in held:
            self.enter(*entry)
        self.turn.open = self._start.done and not self._closed

    def drain_ready(self) -> None:
        """Take what workers send home; chunks of sources are put aside until the workers are at rest."""
        while True:
            try:
                token = self._ready.get_nowait()
            except Empty:
                return
            if isinstance(token, BoundedQueue):
                if isinstance(token.owner, IngressPort):
                    self._put_aside.append(token)
                elif (item := token.take()) is not None:
                    token.owner(item[0], perf_counter_ns())

    def excuse_pause(self, now: float, held_s: float) -> None:
        """The graph was held up for `held_s`: do not count that as silence of the sources."""
        for supervisor in self._supervisors:
            supervisor.last_alive = min(supervisor.last_alive + held_s, now)
        for port in self.ports:
            port.last = min(port.last + held_s, now)

    def is_idle(self, now: float) -> bool:
        """Whether no source needs to be looked at soon."""
        return self._start.done and all(p.supervisor.is_idle(now) and p.is_idle(now - p.last) for p in self.ports)

    def tick(self, now: float) -> None:
        """At `now` (monotonic s), on the graph's turn: the common start's deadlines, and what time has passed on silent sources."""
        if not self._start.done:
            self._start.check_deadlines()
            self._let_in(self._start.release())
        if self._start.done:
            for port in self.ports:
                self._check_silence(port, now - max(port.last, self._start.since))
        self._slot.port = None

    def _check_silence(self, port: IngressPort, age_s: float) -> None:
        """Advance silent streams after their patience, so that readers do not wait; raise the alarm after `stale_s`."""
        if (chunk := port.nothing_for(age_s, self.time.now(), self._log.report)) is not None:
            self._log.enter(port.number, chunk, self._clock.now())
            port.edge.send(chunk, perf_counter_ns())

    def end(self) -> None:
        """End every stream, also those that sources left open."""
        for entry in self.time.early(self._clock.now()):
            self._admit(*entry)
        for port in self.ports:
            if not port.ended:
                port.edge.send(empty(port.edge.spec, FOREVER), perf_counter_ns())

    @property
    def watermarks(self) -> dict[str, Any]:
        """Up to when each stream is complete."""
        return {port.stream: int(port.watermark) for port in self.ports}  # a source may have set it as a numpy integer


def _dropped(session_log: SessionLog, stream: str) -> Callable[[int, int], None]:
    return lambda _, n: session_log.report("source queue dropped", stream=stream, samples=n)


def _inline(
    ingress: Ingress,
    port: IngressPort,
    ready: ReadyQueue,
    slot: CallSlot,
    session_log: SessionLog,
    fail: Callable[[Exception], None],
) -> Inline:
    """What takes a chunk into the graph and works through all that it leads to, or says at once that it must wait.

    After a rest of a few milliseconds, which is how a device's chunks come, a processor has to fetch code and numbers from far memory:
    so it says no by few looks at what is at hand.
    """
    supervisor, queue, turn, enter, at = (
        port.supervisor,
        port.queue,
        ingress.turn,
        ingress.enter,
        port.supervisor.clock.at,
    )
    acquire, release = turn.lock.acquire, turn.lock.release
    long = queue_until = count = worked = since = 0

    def burst(chunk: Chunk, came: int) -> None:
        if port.may_join and chunk.data.nbytes <= JOINED_BYTES:
            ingress.bursts.begin(port, _gathering(ingress, port, take, came, slot, session_log, fail))

    def take(chunk: Chunk, came: int) -> bool:
        nonlocal long, queue_until, count, worked, since
        # cheap looks first, the lock last: a refused chunk goes to the queue and costs little there
        if came < queue_until or not turn.open:
            return False
        # what waits came earlier, from this source or another: overtaking it would change the order in the log
        if queue.waiting or queue.pending_gap or not ready.empty():
            if len(queue.waiting) >= BURST:
                burst(chunk, came)
            return False
        if supervisor.state != "running" or not acquire(False):
            return False
        try:
            # asked again under the lock: the session may have closed while this thread waited for it
            if not turn.open:
                return False
            queue.index += len(chunk.time)
            queue.chunks += 1
            work = enter(port, chunk, at(came))
        except Exception as error:  # noqa: BLE001 - an operator's, or the engine's own: it ends the session
            fail(error)
            return True
        finally:
            slot.port = None
            release()
        session_log.idle_hint()
        long, count, worked = long + 1 if work > LONG_NS else 0, count + 1, worked + work
        # long work on the source's thread delays its reads, so the graph's own thread does it for a second
        if long == LONG_OFTEN:
            long, queue_until = 0, came + NS
        elif count == BURST:
            # chunks came so fast that the source had hardly a pause between them: gather them
            if came - since - worked < BURST * SPARE_NS:
                burst(chunk, came)
            count, worked, since = 0, 0, came
        return True

    return take


def _gathering(
    ingress: Ingress,
    port: IngressPort,
    take: Inline,
    since: int,
    slot: CallSlot,
    session_log: SessionLog,
    fail: Callable[[Exception], None],
) -> Inline:
    """What gathers a burst of chunks from `since` on, and takes them into the graph together; `take` takes them one by one afterwards."""
    supervisor, queue, turn = port.supervisor, port.queue, ingress.turn
    gathered, limit, pauses = queue.gathered, queue.limit, 0

    def gather(chunk: Chunk, came: int) -> bool:
        many, size = len(gathered), chunk.data.nbytes
        if not port.gathers or not turn.open or supervisor.state != "running" or size > JOINED_BYTES or many >= limit:
            return cease(chunk, came)
        gathered.append((chunk, came))
        if not port.gathers:
            queue.leave_gathered()
        elif many + 1 >= GATHERED or (many + 1) * size >= GATHERED_BYTES or came >= since + GATHERED_NS:
            enter(came)
        return True

    def enter(came: int) -> None:
        """Let the queued and gathered chunks enter if no other thread has the turn."""
        nonlocal since, pauses
        if not turn.lock.acquire(False):
            return
        many = queue.depth
        try:
            worked = ingress.enter_together(port)
        except Exception as error:  # noqa: BLE001 - an operator's, or the engine's own: it ends the session
            fail(error)
            return
        finally:
            slot.port = None
            turn.lock.release()
        session_log.idle_hint()
        pauses = 0 if came - since - worked < many * SPARE_NS else pauses + 1
        if pauses == PAUSES:
            port.gathers = False
        since = came

    def cease(chunk: Chunk, came: int) -> bool:
        """Move what is gathered into the queue before this chunk, unless it was taken."""
        port.gathers = False
        supervisor.inline[port.output] = take
        return not gathered and take(chunk, came)

    return gather
