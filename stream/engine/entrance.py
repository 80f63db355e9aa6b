"""Where sources' chunks come into the graph, one after the other: by the sources' own doors, or through queues and one doorbell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import Empty
from time import perf_counter_ns

from stream.chunk import FOREVER, NEVER, Chunk, empty
from stream.engine.channel import Channel, Doorbell
from stream.engine.clock import SessionClock
from stream.engine.door import Turn, door
from stream.engine.intake import CommonStart, Intake
from stream.engine.journal import Former, Journal
from stream.engine.pipeline import Pipeline
from stream.engine.supervisor import Runner


class Entrance:
    """All that stands between the sources and the graph.

    intakes   one per output of a source
    turn      who works on the graph now
    over      whether every source that a session lasts for has ended
    """

    def __init__(
        self,
        bell: Doorbell,
        runners: Sequence[Runner],
        pipeline: Pipeline,
        journal: Journal,
        clock: SessionClock,
        former: Former | None,
        fail: Callable[[Exception], None],
    ) -> None:
        """`bell` rings for what waits, also for what lanes send home; `fail` is told what operators raise on a source's thread."""
        self._bell, self._journal, self._clock = bell, journal, clock
        self._runners = runners
        self._put_aside: list[Channel] = []
        self._closed = self.over = False
        self.turn = Turn()
        self._start = CommonStart(runners)
        self.intakes = [self._intake(r, output, pipeline, former, fail) for r in runners for output in r.channels]
        for runner in runners:
            runner.awaited = any(i.awaited for i in self.intakes if i.runner is runner)

    def _intake(
        self, runner: Runner, output: str, pipeline: Pipeline, former: Former | None, fail: Callable[[Exception], None]
    ) -> Intake:
        channel, journal = runner.channels[output], self._journal
        name, wire = channel.name, pipeline.entries[channel.name]
        intake = Intake(
            name, runner, output, wire, journal.add_input(name, wire.spec, former.recorded(name) if former else 0)
        )
        if former and former.checkpoint:
            intake.promised = former.checkpoint.promised.get(name, NEVER)
        channel.owner = intake
        channel.on_drop = lambda _, n: journal.report("source queue dropped", stream=name, samples=n)
        runner.doors[output] = door(intake, journal, self.turn, self._bell, fail)
        return intake

    def begin(self) -> None:
        """The sources are started now: from now on it counts how long they take."""
        self._start.begin()

    def close(self) -> None:
        """No source goes in by itself any more; what waits can still be served."""
        self._closed, self.turn.open = True, False

    def serve(self, timeout_s: float) -> None:
        """Take the next chunk, whoever it comes from; waits at most `timeout_s` for one."""
        if self._put_aside:
            channel = self._put_aside.pop(0)
        else:
            try:
                token = self._bell.get(timeout=timeout_s)
            except Empty:
                return
            if not isinstance(token, Channel):
                return
            channel = token
        with self.turn.lock:
            if (item := channel.take()) is None:
                return
            if not isinstance(channel.owner, Intake):
                channel.owner(item[0], perf_counter_ns())
            elif self._start.done:
                self._enter(channel.owner, *item)
            else:
                self._let_in(self._start.pass_on(channel.owner, *item))

    def serve_all(self) -> None:
        """Work through everything that waits."""
        while not self._bell.empty() or self._put_aside:
            self.serve(0.0)

    def _let_in(self, held: list[tuple[Intake, Chunk, int]]) -> None:
        """What may enter before and at the common start; from then on sources have doors of their own."""
        for entry in held:
            self._enter(*entry)
        self.turn.open = self._start.done and not self._closed

    def _enter(self, intake: Intake, chunk: Chunk, arrival: int) -> None:
        """A source's chunk enters the graph, and all that it leads to is done."""
        admitted = intake.admit(chunk, arrival, self._journal.report)
        if admitted is not None:
            self._journal.enter(intake.number, admitted, arrival)
            intake.wire.send(admitted, perf_counter_ns())
            if admitted.until == FOREVER:
                self.over = self._all_ended()

    def _all_ended(self) -> bool:
        lasting = [i for i in self.intakes if not i.runner.source.background]
        return bool(lasting) and all(i.ended for i in lasting)

    def pump(self) -> None:
        """Take what lanes send home; chunks of sources are put aside until the lanes are at rest."""
        while True:
            try:
                token = self._bell.get_nowait()
            except Empty:
                return
            if isinstance(token, Channel):
                if isinstance(token.owner, Intake):
                    self._put_aside.append(token)
                elif (item := token.take()) is not None:
                    token.owner(item[0], perf_counter_ns())

    def forgive(self, now: float, held_s: float) -> None:
        """The graph was held up for so long: that is no silence of the sources, whose chunks may come just after."""
        for runner in self._runners:
            runner.last_alive = min(runner.last_alive + held_s, now)
        for intake in self.intakes:
            intake.last = min(intake.last + held_s, now)

    def at_ease(self, now: float) -> bool:
        """Whether no source needs to be looked at soon."""
        return self._start.done and all(i.runner.at_ease(now) and i.at_ease(now - i.last) for i in self.intakes)

    def look_after(self, now: float) -> None:
        """At `now` (monotonic s), on the graph's turn: the common start's deadlines, and what time has passed on silent sources."""
        if not self._start.done:
            self._start.check_deadlines()
            self._let_in(self._start.release())
        if self._start.done:
            for intake in self.intakes:
                self._check_silence(intake, now - max(intake.last, self._start.since))

    def _check_silence(self, intake: Intake, age_s: float) -> None:
        """After the stated patience, say that nothing happened, so that nobody waits; after `stale_s`, raise the alarm."""
        if (chunk := intake.nothing_for(age_s, self._clock.now(), self._journal.report)) is not None:
            self._journal.enter(intake.number, chunk, self._clock.now())
            intake.wire.send(chunk, perf_counter_ns())

    def end(self) -> None:
        """Every source has ended, whether it has said so or not."""
        for intake in self.intakes:
            if not intake.ended:
                intake.wire.send(empty(intake.wire.spec, FOREVER), perf_counter_ns())
