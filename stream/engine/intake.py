"""Where a source's chunks enter the graph: what is too late is decided here, once, and the sources' common start."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stream.chunk import FOREVER, NEVER, NS, Chunk, add_lost, empty, utc
from stream.engine.supervisor import REST_S, Runner
from stream.engine.wire import Wire
from stream.errors import DeviceError

LONG_AGO = 10**8 * NS
"""In 1973: a live sample's stamp that lies before is rather one in other units."""


AHEAD_NS = NS
"""A live sample's stamp may lie so far after its arrival, by what a device's clock is wrong; beyond that it is told."""


@dataclass(slots=True)
class Intake:
    """One output of a source, as the graph sees it.

    number     its number in the input log
    promised   the stream is complete up to this time; what comes later and is older is dropped
    last       when its last chunk came (monotonic s)
    late       samples dropped because they came too late
    owed       what is missing before the next sample, beyond what its chunk says
    watched    whether it is still to be seen to that stamps do not lie ahead of the session's clock
    """

    stream: str
    runner: Runner
    output: str
    wire: Wire
    number: int = -1
    promised: int = NEVER
    last: float = field(default_factory=time.monotonic)
    late: int = 0
    owed: int = 0
    silent: bool = False
    stale: bool = False
    watched: bool = field(init=False)

    def __post_init__(self) -> None:
        self.watched = self.runner.source.live

    @property
    def ended(self) -> bool:
        return self.promised == FOREVER

    @property
    def awaited(self) -> bool:
        """Whether anybody waits for what time brings here. Where nobody does, only samples are let in."""
        return bool(self.wire.readers)

    @property
    def minded(self) -> bool:
        """Whether it matters that nothing comes: not of people's words that nobody waits for."""
        return not self.ended and (self.awaited or not self.runner.source.background)

    def admit(self, chunk: Chunk, arrival: int, report: Callable[..., None]) -> Chunk | None:
        """The chunk as it may enter: without late samples, its `until` never going back; None if it says nothing new."""
        self.last = time.monotonic()
        self.silent = self.stale = False
        if self.watched and arrival + AHEAD_NS < chunk.until < FOREVER:
            self.watched = False
            ahead_s, hint = (
                round((chunk.until - arrival) / NS, 1),
                "Feed.now() and devices.clocks give stamps of the session's clock",
            )
            report("stamps lie ahead of the clock", stream=self.stream, ahead_s=ahead_s, hint=hint)
        if len(chunk.time) and chunk.time.item(0) <= self.promised:
            chunk = self._without_late(chunk, report)
        if not (len(chunk.time) or chunk.lost or self.awaited or chunk.until == FOREVER):
            return None
        if self.owed and len(chunk.time):
            chunk.lost, self.owed = add_lost(self.owed, chunk.lost), 0
        if chunk.until <= self.promised:
            if not len(chunk.time) and not chunk.lost:
                return None
            chunk.until = self.promised
        self.promised = chunk.until
        return chunk

    def nothing_for(self, age_s: float, now: int, report: Callable[..., None]) -> Chunk | None:
        """Told at `now` (ns) that nothing has come for `age_s`. Once that is longer than the stated patience: the chunk that says that
        nothing happened, so that nobody waits; the alarm is raised after `stale_s`. What waits in the queue has come."""
        options = self.runner.node.options
        if not self.minded or self.runner.channels[self.output].waiting:
            return None
        if 0 < options.stale_s < age_s and not self.stale:
            self.stale = True
            report("stream is stale", stream=self.stream, age_s=round(age_s, 2))
        until = now - int(options.patience_s * NS)
        if not self.awaited or not 0 < options.patience_s < age_s or until <= self.promised:
            return None
        if not self.silent:
            self.silent = True
            report("silent source advanced", stream=self.stream, to=utc(until))
        self.promised = until
        return empty(self.wire.spec, until)

    def at_ease(self, age_s: float) -> bool:
        """Whether nothing becomes due within `REST_S`, after nothing has come for `age_s`."""
        options = self.runner.node.options
        waits_s = (options.patience_s if self.awaited else 0.0, 0.0 if self.stale else options.stale_s)
        return not self.minded or all(age_s + REST_S < wait_s for wait_s in waits_s if wait_s)

    def _without_late(self, chunk: Chunk, report: Callable[..., None]) -> Chunk:
        keep = chunk.time > self.promised
        n = int((~keep).sum())
        self.late += n
        hint = (
            {"hint": "stamps are nanoseconds since 1970, as Feed.now() gives them"} if chunk.time[-1] < LONG_AGO else {}
        )
        report("late samples dropped", stream=self.stream, samples=n, at=utc(int(chunk.time[0])), **hint)
        times, data = np.ascontiguousarray(chunk.time[keep]), np.ascontiguousarray(chunk.data[keep])
        return Chunk(times, data, chunk.until, add_lost(chunk.lost, n))


class CommonStart:
    """No sample passes until every required source is ready. What a live device sends before is left out; files and people wait instead.

    since   when that was (monotonic s), or when the waiting began
    """

    def __init__(self, runners: Sequence[Runner]) -> None:
        self._required = [r for r in runners if r.node.options.required and not r.source.background]
        self._held: list[tuple[Intake, Chunk, int]] = []
        self._began = self.since = time.monotonic()
        self.done = False

    def begin(self) -> None:
        """The sources are started now."""
        self._began = self.since = time.monotonic()

    def pass_on(self, intake: Intake, chunk: Chunk, arrival: int) -> list[tuple[Intake, Chunk, int]]:
        """What may enter now that this chunk has come: it and all that was held, or nothing yet."""
        if self.done:
            return [(intake, chunk, arrival)]
        source = intake.runner.source
        if self.ready or source.background or not source.live:
            self._held.append((intake, chunk, arrival))
        return self.release()

    def release(self) -> list[tuple[Intake, Chunk, int]]:
        """What was held, once all required sources are ready."""
        if not self.ready:
            return []
        self.done = True
        self.since = time.monotonic()
        held, self._held = self._held, []
        return held

    @property
    def ready(self) -> bool:
        return all(r.ready for r in self._required)

    def check_deadlines(self) -> None:
        """Raise DeviceError for a required source that is not ready in time."""
        waited = time.monotonic() - self._began
        for runner in self._required:
            deadline = runner.node.options.deadline_s
            if not runner.ready and waited > deadline:
                why = f": {runner.error}" if runner.error else ""
                raise DeviceError(
                    f"source {runner.node.name!r} gave nothing within {deadline:g} s{why};"
                    " connect it, or set `required: false` or a longer `deadline_s`"
                )


def promises(intakes: list[Intake]) -> dict[str, Any]:
    """Up to when each stream is complete."""
    return {intake.stream: int(intake.promised) for intake in intakes}  # a source may have said it in numpy's integers
