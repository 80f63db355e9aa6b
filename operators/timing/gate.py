"""A gate: samples pass from one trigger pulse to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Specs, StreamSpec, add_lost, empty
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param


@dataclass(slots=True)
class GateState:
    """`passing`: now; `opened`: how often it has been; `closed`: when it was closed last; `held`: samples kept back since then."""

    passing: bool
    opened: int
    closed: int
    held: int


class _Gated(Operator[GateState]):
    __slots__ = ("nothing",)
    nothing: Array


@dataclass(frozen=True, slots=True)
class Gate(_Gated):
    """Samples of any kind in and out, from a trigger pulse on until the next one: start and stop by another device.

    pulses   events: `onset` of `operators.filters.threshold.Threshold` on a TTL channel, or markers of `devices.lsl.LslInlet`
    in       any stream

    The first pulse opens, the next closes, and so on. With `start` or `stop`, only a marker of that text opens, or closes. A sample at the
    stamp of the opening pulse passes, one at the closing pulse's does not. What came before the first pulse was never asked for; what was
    kept back later counts as lost. The recording's input log holds all of it, so a replay can be cut otherwise. Samples wait until the
    pulses are known up to their time; no delay otherwise.

    What follows looks ahead, and decides late: an envelope needs the signal of 0.23 s more, a touch-down is reported some time after it
    happened. With `tail_s` a signal passes for so long after the closing pulse, and of events with an `onset` those that began before it;
    so the last cycle that ended before the pulse is not lost.

    >>> pulses = events([1.02, 1.05], [("onset", "<i8")])
    >>> apply(Gate(), pulses=pulses, **{"in": series(np.arange(8.0), rate_hz=100)})[:, 0]
    array([2., 3., 4.])
    """

    inputs = {"pulses": Input(), "in": Input(trigger=True)}
    exemptions: ClassVar[dict[str, str]] = {"infinity": "what passes is not looked at"}

    start: str = param("", help="the marker that opens; left out: any pulse")
    stop: str = param("", help="the marker that closes; left out: any pulse")
    tail_s: float = param(
        0.0, least=0.0, most=60.0, help="for so long after it passes what belongs to the time before it"
    )

    def open(self, specs: Specs) -> Specs:
        pulses = specs["pulses"]
        if not pulses.is_event:
            raise InputError(
                "pulses", pulses.describe(), "events; operators.filters.threshold.Threshold makes them of a signal"
            )
        if (self.start or self.stop) and "text" not in (pulses.dtype.names or ()):
            name = "start" if self.start else "stop"
            raise ParameterError(name, self.start or self.stop, "left out: these pulses have no field `text`")
        object.__setattr__(self, "nothing", empty(specs["in"], 0).data)
        self.set_state(GateState(False, 0, NEVER, 0))
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        if port == "pulses":
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                self._pulse(stamp, str(row["text"]) if self.start or self.stop else "")
            return Chunk(chunk.time[:0], self.nothing, chunk.until)
        if not len(chunk):
            return chunk
        if not s.opened:
            return Chunk(chunk.time[:0], self.nothing, chunk.until)
        late = 0 if s.passing else len(chunk) - int(np.searchsorted(chunk.time, s.closed + round(self.tail_s * NS)))
        passes = np.arange(len(chunk)) < len(chunk) - late
        if not s.passing and "onset" in (chunk.data.dtype.names or ()):
            passes &= chunk.data["onset"] < s.closed
        lost, s.held = add_lost(s.held, chunk.lost), 0
        if not passes.any():
            s.held = add_lost(lost, late)
            return Chunk(chunk.time[:0], self.nothing, chunk.until)
        s.held = late
        whole = passes.all()
        return Chunk(
            chunk.time if whole else chunk.time[passes], chunk.data if whole else chunk.data[passes], chunk.until, lost
        )

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(32)
        times = np.array([1_500_000_000, 3_020_000_000, 4_000_000_000, 5_500_000_000])
        onset = np.array([(int(t),) for t in times], [("onset", "<i8")])
        texts = np.array([(b,) for b in ("hello", "go", "on", "end")], [("text", "<U8")])
        signal, touch = StreamSpec((2,), rate_hz=100.0), np.array([(1,)] * 40, [("onset", "<i8")])
        samples = (signal, grid(100.0, 700), rng.random((700, 2)))
        events = (StreamSpec((), touch.dtype), grid(8.0, 40), touch)
        known = grid(8.0, 40)
        late = (StreamSpec((), touch.dtype), known, (known - 300_000_000 * (1 + np.arange(40) % 4)).view(touch.dtype))
        return [
            Case(cls(), {"pulses": (StreamSpec((), onset.dtype), times, onset), "in": samples}, least=250),
            Case(cls(tail_s=0.2), {"pulses": (StreamSpec((), onset.dtype), times, onset), "in": samples}, least=280),
            Case(
                cls("go", "end", tail_s=1.5),
                {"pulses": (StreamSpec((), texts.dtype), times, texts), "in": late},
                least=12,
            ),
            Case(cls("go", "end"), {"pulses": (StreamSpec((), texts.dtype), times, texts), "in": events}, least=10),
        ]

    def _pulse(self, stamp: int, text: str) -> None:
        s = self.state
        wanted = self.stop if s.passing else self.start
        if wanted in ("", text):
            s.passing = not s.passing
            s.opened += s.passing
            s.closed = s.closed if s.passing else stamp
