"""Ends the session when a trigger says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import structlog

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Specs
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class SessionEndState:
    """pulses: how many there have been;  over: when the session is over; NEVER: not known, FOREVER: it was ended."""

    pulses: int
    over: int


@dataclass(slots=True)
class SessionEndRuntime:
    """What ends a live session; None in replay."""

    stop: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class SessionEnd(Outlet[SessionEndState, SessionEndRuntime]):
    """Events in; the session ends with one of them, in order, as by Ctrl-C: what has arrived is worked through, the recording closed.

    in       events: pulses of a trigger (`operators.filters.threshold.Threshold` on a TTL channel, markers from LSL), or any others

    With `text`, only markers of that text count. With `after_s` it goes on for so long after that event, for what looks ahead (`tail_s` of
    `operators.timing.gate.Gate`). A replay ends with its recording.
    """

    pulse: int = param(2, least=1, help="the how-manieth pulse ends it: 2 where the first one starts")
    text: str = param("", help="the marker that counts; left out: every event")
    after_s: float = param(0.0, least=0.0, most=60.0, help="how long after it the session ends")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_event:
            raise InputError(
                "in", spec.describe(), "events; operators.filters.threshold.Threshold makes them of a signal"
            )
        if self.text and "text" not in (spec.dtype.names or ()):
            raise ParameterError("text", self.text, "left out: these events have no field `text`")
        self.set_state(SessionEndState(0, NEVER), SessionEndRuntime())
        return {}

    def let_stop(self, stop: Callable[[], None]) -> None:
        self.runtime.stop = stop

    def process(self, port: str, chunk: Chunk) -> None:
        state, stop = self.state, self.runtime.stop
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            state.pulses += not self.text or str(row["text"]) == self.text
            if state.pulses == self.pulse and state.over == NEVER:
                state.over = stamp + round(self.after_s * NS)
        if state.over not in (NEVER, FOREVER) and state.over <= chunk.until:
            state.over = FOREVER
            if stop is not None:
                log.info("the session ends on a trigger", pulse=self.pulse)
                stop()
