"""Ends the session when a trigger says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import structlog

from stream.chunk import Chunk, Specs
from stream.errors import InputError, ParameterError
from stream.operator import Outlet
from stream.params import param

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class SessionEndState:
    """pulses: how many there have been."""

    pulses: int


@dataclass(slots=True)
class SessionEndRuntime:
    """What ends a live session; None in replay."""

    stop: Callable[[], None] | None = None


@dataclass(frozen=True, slots=True)
class SessionEnd(Outlet[SessionEndState, SessionEndRuntime]):
    """Events in; the session ends with one of them, in order, as by Ctrl-C: what has arrived is worked through, the recording closed.

    in       events: pulses of a trigger (`operators.threshold.Threshold` on a TTL channel, markers from LSL), or any others

    With `text`, only markers of that text count. A replay ends with its recording.
    """

    pulse: int = param(2, least=1, help="the how-manieth pulse ends it: 2 where the first one starts")
    text: str = param("", help="the marker that counts; left out: every event")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_event:
            raise InputError("in", spec.describe(), "events; operators.threshold.Threshold makes them of a signal")
        if self.text and "text" not in (spec.dtype.names or ()):
            raise ParameterError("text", self.text, "left out: these events have no field `text`")
        self.hold(SessionEndState(0), SessionEndRuntime())
        return {}

    def let_stop(self, stop: Callable[[], None]) -> None:
        self.runtime.stop = stop

    def process(self, port: str, chunk: Chunk) -> None:
        state, stop = self.state, self.runtime.stop
        before = state.pulses
        state.pulses += sum(1 for row in chunk.data if not self.text or str(row["text"]) == self.text)
        if before < self.pulse <= state.pulses and stop is not None:
            log.info("the session ends: a trigger says so", pulse=self.pulse)
            stop()
