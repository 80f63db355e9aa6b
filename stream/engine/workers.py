"""Workers: threads for frame-sized work and for outlets, each behind bounded queues, their results back in order by time.

What runs on a worker gets the same samples in the same order as on the graph's own thread; only a queue that drops can change anything, and
its drops are recorded (by the samples' running index on that edge), so that replay repeats them. A watchdog reads off each worker's slot
which call is under way, on any interpreter.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from queue import SimpleQueue
from time import perf_counter_ns

from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.engine.flow.edge import CallSlot, InputPort, Push, given
from kinegraph.stream.engine.flow.queues import BoundedQueue, Drops, ReadyQueue
from kinegraph.stream.engine.pipeline import Stage
from kinegraph.stream.errors import RunError
from kinegraph.stream.graph import Edge, policy_of
from kinegraph.stream.graph.backpressure import Policy, max_bytes

UNLIMITED = 1 << 62


class Worker:
    """One thread that works through what its queues bring."""

    def __init__(self, name: str, fail: Callable[[Exception], None], slot: CallSlot) -> None:
        """`slot` says what it calls now."""
        self.ready: ReadyQueue = SimpleQueue()
        self._fail, self._slot = fail, slot
        self._thread = threading.Thread(target=self._work, name=f"worker {name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _work(self) -> None:
        broken = False
        while (token := self.ready.get()) is not None:
            if isinstance(token, threading.Event):
                token.set()
            elif (item := token.take()) is not None and not broken:
                try:
                    token.owner(item[0], perf_counter_ns())
                except Exception as error:  # noqa: BLE001 - handed to the graph's thread, which stops the run
                    broken = True
                    self._fail(error)
                finally:
                    self._slot.port = None

    def stop(self, timeout_s: float) -> bool:
        """Ask the thread to end after what waits; returns whether it did."""
        self.ready.put(None)
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()


class Workers:
    """All workers of a run, and the queues between them and the graph's own thread.

    on_drop   called at every drop with queue (its name), first (the dropped samples' running index), samples (how many)
    """

    def __init__(
        self, home: ReadyQueue, waits: bool, fail: Callable[[Exception], None], on_drop: Callable[..., None]
    ) -> None:
        """`home` is the ready queue of the graph's thread; `waits` says that no source is live, so that an outlet need never drop."""
        self._home, self._waits, self._fail, self._on_drop = home, waits, fail, on_drop
        self.workers: dict[str, Worker] = {}
        self.queues: dict[str, BoundedQueue] = {}
        self._repeated: dict[str, Drops] = {}
        self._policies: dict[str, Policy] = {}

    def bridge(self, stage: Stage, port: str, edge: Edge, push: Push) -> Push:
        """A queue before `stage`'s port; the stage runs on its worker."""
        options = stage.node.options
        policy = policy_of(stage.node, live=not self._waits)
        name = f"{edge} -> {stage.node.name}.{port}"
        if stage.worker:
            if stage.worker not in self.workers:
                self.workers[stage.worker] = Worker(stage.worker, self._fail, stage.slot)
            queue = BoundedQueue(
                name,
                self.workers[stage.worker].ready,
                options.queue,
                policy,
                lambda i, n: self._on_drop(queue=name, first=i, samples=n),
                max_bytes(policy, live=not self._waits),
            )
        else:  # back home: never waits, for the graph's thread may itself be waiting for this worker
            queue = BoundedQueue(name, self._home, UNLIMITED, "block")
        queue.owner = push
        self.queues[name] = queue
        stage.limits.append(queue)

        def put(chunk: Chunk, start: int) -> int:
            if self._repeated and name in self._repeated:
                chunk = self._repeated[name].repeat(chunk)
            queue.put(chunk)
            return perf_counter_ns()

        return put

    def start(self) -> None:
        """Let the threads work."""
        for worker in self.workers.values():
            worker.start()

    @property
    def indices(self) -> dict[str, int]:
        """How many samples have gone into each queue."""
        return {name: queue.index for name, queue in self.queues.items()}

    def repeat(self, drops: dict[str, Drops], indices: dict[str, int]) -> None:
        """Until `go_on`, leave out what a log says was dropped, and nothing else; `indices` says how far each queue had come."""
        for name, queue in self.queues.items():
            self._repeated[name] = drops.get(name, Drops())
            self._repeated[name].index = indices.get(name, 0)
            self._policies[name], queue.policy = queue.policy, "block"

    def go_on(self) -> None:
        """The log ends here: from now on queues drop by themselves, where they are in the running count of all that came."""
        for name, repeated in self._repeated.items():
            queue = self.queues[name]
            queue.index, queue.pending_gap, queue.policy = repeated.index, repeated.pending_gap, self._policies[name]
        self._repeated = {}

    def settle(self, drain_ready: Callable[[], None]) -> None:
        """Wait until every worker has worked through what it has; `drain_ready` meanwhile takes their results on the graph's thread."""
        before = -1
        while before != (before := sum(c.chunks for c in self.queues.values())):
            for worker in self.workers.values():
                done = threading.Event()
                worker.ready.put(done)
                while not done.wait(0.0005):
                    drain_ready()
            drain_ready()

    def stop(self, timeout_s: float = 10.0) -> list[str]:
        """End the threads; returns the names of those that did not end in time."""
        for queue in self.queues.values():
            queue.close()
        return [name for name, worker in self.workers.items() if not worker.stop(timeout_s)]


@dataclass(frozen=True, slots=True)
class Call:
    """A call of an operator or outlet that has not come back yet.

    since   when it was first found under way (ns, perf_counter): it began then at the latest
    where   what it was given, in words; "" if nothing
    """

    node: str
    since: int
    where: str = ""

    @property
    def lasts_s(self) -> float:
        """For how long it has been found at work."""
        return (perf_counter_ns() - self.since) / NS

    def broken_off(self) -> RunError:
        """What it means that the session ended without it."""
        return RunError(
            f"node {self.node!r}: did not come back for {self.lasts_s:.1f} s{self.where}; the session ended without it"
        )


@dataclass(slots=True)
class _Found:
    """What a slot held when it was looked at last, and since which look it has held that."""

    port: InputPort | None
    chunk: Chunk | None
    node: str
    since: int


class Watchdog:
    """Looks at the slots of a session's workers; a call that two looks find is one that lasts."""

    def __init__(self, slots: Iterable[CallSlot]) -> None:
        self._slots = list(slots)
        self._found: dict[int, _Found] = {}

    def look(self) -> Call | None:
        """The call that has been found under way for longest; None if every operator is at rest."""
        now = perf_counter_ns()
        calls = [call for slot in self._slots if (call := self._call(slot, now))]
        return min(calls, key=lambda call: call.since, default=None)

    def _call(self, slot: CallSlot, now: int) -> Call | None:
        port, node = slot.port, slot.node
        chunk = None if port is None else slot.chunk
        if port is None and not node:
            self._found.pop(id(slot), None)
            return None
        before = self._found.get(id(slot))
        if before is None or before.port is not port or before.chunk is not chunk or before.node != node:
            before = self._found[id(slot)] = _Found(port, chunk, node, now)
        if port is None or chunk is None:
            return Call(node, before.since)
        return Call(port.node, before.since, given(port.port, chunk))
