"""Lanes: threads for frame-sized work and for outlets, each behind bounded queues, their results back in order by time.

What runs on a lane gets the same samples in the same order as on the graph's own thread; only a queue that drops can change anything, and
its drops are recorded (by the samples' running index on that edge), so that replay repeats them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from time import perf_counter_ns

from stream.chunk import Chunk
from stream.engine.channel import Channel, Doorbell
from stream.engine.drops import Drops
from stream.engine.link import Push
from stream.engine.pipeline import Stage
from stream.graph import Edge, Policy

UNLIMITED = 1 << 62


class Lane:
    """One thread that works through what its channels bring."""

    def __init__(self, name: str, fail: Callable[[Exception], None]) -> None:
        self.bell: Doorbell = SimpleQueue()
        self._fail = fail
        self._thread = threading.Thread(target=self._work, name=f"lane {name}", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        broken = False
        while (token := self.bell.get()) is not None:
            if isinstance(token, threading.Event):
                token.set()
            elif (item := token.take()) is not None and not broken:
                try:
                    token.owner(item[0], perf_counter_ns())
                except Exception as error:  # noqa: BLE001 - handed to the graph's thread, which stops the run
                    broken = True
                    self._fail(error)

    def stop(self, timeout_s: float) -> bool:
        """Ask the thread to end after what waits; returns whether it did."""
        self.bell.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()


class Lanes:
    """All lanes of a run, and the channels between them and the graph's own thread.

    on_drop   told (name of the queue, first, n) of every drop
    """

    def __init__(
        self, home: Doorbell, waits: bool, fail: Callable[[Exception], None], on_drop: Callable[[str, int, int], None]
    ) -> None:
        """`home` is the doorbell of the graph's thread; `waits` says that no source is live, so that an outlet need never drop."""
        self._home, self._waits, self._fail, self._on_drop = home, waits, fail, on_drop
        self.lanes: dict[str, Lane] = {}
        self.channels: dict[str, Channel] = {}
        self._repeated: dict[str, Drops] = {}
        self._policies: dict[str, Policy] = {}

    def bridge(self, stage: Stage, port: str, edge: Edge, push: Push) -> Push:
        """A queue before `stage`'s port; the stage runs on its lane."""
        options = stage.node.options
        policy: Policy = options.policy or ("drop_oldest" if stage.node.is_outlet and not self._waits else "block")
        name = f"{edge} -> {stage.node.name}.{port}"
        if stage.lane:
            if stage.lane not in self.lanes:
                self.lanes[stage.lane] = Lane(stage.lane, self._fail)
            channel = Channel(
                name, self.lanes[stage.lane].bell, options.queue, policy, lambda i, n: self._on_drop(name, i, n)
            )
        else:  # back home: never waits, for the graph's thread may itself be waiting for this lane
            channel = Channel(name, self._home, UNLIMITED, "block")
        channel.owner = push
        self.channels[name] = channel
        stage.limits.append(channel)

        def put(chunk: Chunk, start: int) -> int:
            if self._repeated and name in self._repeated:
                chunk = self._repeated[name].repeat(chunk)
            channel.put(chunk)
            return perf_counter_ns()

        return put

    @property
    def indices(self) -> dict[str, int]:
        """How many samples have gone into each queue."""
        return {name: channel.index for name, channel in self.channels.items()}

    def repeat(self, drops: dict[str, Drops], indices: dict[str, int]) -> None:
        """Until `go_on`, leave out what a log says was dropped, and nothing else; `indices` says how far each queue had come."""
        for name, channel in self.channels.items():
            self._repeated[name] = drops.get(name, Drops())
            self._repeated[name].index = indices.get(name, 0)
            self._policies[name], channel.policy = channel.policy, "block"

    def go_on(self) -> None:
        """The log ends here: from now on queues drop by themselves, where they are in the running count of all that came."""
        for name, repeated in self._repeated.items():
            channel = self.channels[name]
            channel.index, channel.owed, channel.policy = repeated.index, repeated.owed, self._policies[name]
        self._repeated = {}

    def settle(self, pump: Callable[[], None]) -> None:
        """Wait until every lane has worked through what it has; `pump` meanwhile takes their results on the graph's thread."""
        before = -1
        while before != (before := sum(c.chunks for c in self.channels.values())):
            for lane in self.lanes.values():
                done = threading.Event()
                lane.bell.put(done)
                while not done.wait(0.0005):
                    pump()
            pump()

    def stop(self, timeout_s: float = 10.0) -> list[str]:
        """End the threads; returns the names of those that did not end in time."""
        for channel in self.channels.values():
            channel.close()
        return [name for name, lane in self.lanes.items() if not lane.stop(timeout_s)]
