"""Open Sound Control in, from any program: streams declared by address and arguments, as serial frames are by their fields."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.clocks.timing import chunks_of_one, timing_spec
from kinegraph.devices.frames.declared import NS_PER
from kinegraph.devices.osc.protocol import Argument, OscError, OscReader
from kinegraph.devices.transport.datagrams import GATHER_HELP, UdpTransport, gathered_s
from kinegraph.devices.transport.transport import unreachable
from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters

WAIT_S = 0.1


@dataclass(frozen=True, slots=True)
class OscArgument:
    """One argument of a message, in order: a number that becomes a channel, a counter, the sender's time; nameless ones are passed over."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    name: str = param("", help="the channel's name; without one the argument is passed over")
    role: Literal["data", "counter", "time"] = param(
        "data", help="data, a counter of messages (32 bits), or the sender's time"
    )
    scale: float = param(1.0, help="factor from the number to the unit")
    unit: str = param("", help="unit of the channel, or of the time: ns, us, ms, s")


@dataclass(frozen=True, slots=True)
class OscStream:
    """Messages of one address: an output of that name."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    name: str = param(help="the output's name")
    address: str = param(help="the messages' address: /imu/acc")
    arguments: tuple[OscArgument, ...] = param(help="what the message holds, in order; more than these are passed over")
    rate_hz: float | None = param(None, above=0, help="messages per second; left out: irregular")

    @property
    def channels(self) -> tuple[OscArgument, ...]:
        return tuple(a for a in self.arguments if a.role == "data" and a.name)

    @property
    def is_clocked(self) -> bool:
        """Whether its stamps follow a counter or the sender's time."""
        return any(a.role != "data" for a in self.arguments)


@dataclass(frozen=True, slots=True)
class OscInlet(Source):
    """Numbers that any program sends by OSC over UDP (phones, Max, TouchDesigner, game engines).

    NAME     (channels,) float64: the declared arguments of that address; an output for each stream
    timing   an event per message: its counter, the sender's time, arrival, stamp

    Stamps follow the sender's time where a message brings it, else the counter (with `rate_hz`), else the arrival. UDP loses and doubles
    messages: only a counter or a time tells. What is left out is counted by reason.
    """

    streams: tuple[OscStream, ...] = param(help="what is taken")
    host: str = param("127.0.0.1", help="the address that is listened on; 0.0.0.0: all, for senders on other machines")
    port: int = param(9000, least=1, most=65535, help="the UDP port that is listened on")
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to its arrival, if you know it"
    )
    gather_s: float | None = param(None, least=0, most=0.1, help=GATHER_HELP)

    @outputs_by_parameters()
    def outputs(self) -> tuple[str, ...]:
        return (*(s.name for s in self.streams), "timing")

    @property
    def chunk_s(self) -> float:
        return max([self.gathered_s, *(1 / s.rate_hz for s in self.streams if s.rate_hz)])

    @property
    def gathered_s(self) -> float:
        """How long messages are left to gather after one that was read."""
        if self.gather_s is not None:
            return self.gather_s
        return gathered_s(s.rate_hz if s.is_clocked else None for s in self.streams)

    def specs(self) -> Specs:
        specs: Specs = {}
        for i, s in enumerate(self.streams):
            names = tuple(a.name for a in s.channels)
            if not s.name.isidentifier() or s.name == "timing" or s.name in specs:
                raise ParameterError(
                    f"streams[{i}].name", s.name, "letters, digits and '_', another one for each, and not 'timing'"
                )
            if not s.address.startswith("/"):
                raise ParameterError(f"streams[{i}].address", s.address, "an address that begins with a slash")
            if not names or len(set(names)) != len(names):
                raise ParameterError(
                    f"streams[{i}].arguments", list(names), "at least one named number, of different names"
                )
            if any(a.role == "time" and a.unit not in NS_PER for a in s.arguments):
                raise ParameterError(f"streams[{i}].arguments", "time", f"a unit out of {', '.join(NS_PER)} for a time")
            if any([a.role for a in s.arguments].count(role) > 1 for role in ("counter", "time")):
                raise ParameterError(f"streams[{i}].arguments", "counter, time", "at most one of each")
            specs[s.name] = StreamSpec(
                (len(names),), rate_hz=s.rate_hz, channels=names, units=tuple(a.unit for a in s.channels)
            )
        if not specs:
            raise ParameterError("streams", [], "at least one stream")
        return {**specs, "timing": timing_spec()}

    def missing(self) -> str:
        return unreachable(f"udp://{self.host}:{self.port}")

    def prepare(self) -> None:
        line_below.prepare()

    def read(self, feed: Feed) -> None:
        readings: dict[str, list[OscReading]] = {}
        for s in self.streams:
            readings.setdefault(s.address, []).append(OscReading(self, s))
        last, reader = 0, OscReader()
        with UdpTransport(f"udp://{self.host}:{self.port}", self.gathered_s) as port:
            feed.ready()
            while not feed.stopped:
                if not (data := port.read(WAIT_S)):
                    continue
                try:
                    messages = reader.read(data)
                except OscError:
                    feed.problem("not OSC")
                    continue
                arrival = feed.now()
                for address, arguments in messages:
                    if address not in readings:
                        feed.problem("message of an address that no stream takes")
                    for reading in readings.get(address, ()):
                        last = reading.take(arguments, arrival, last, feed)


class OscReading:
    """One stream's messages to chunks."""

    def __init__(self, of: OscInlet, stream: OscStream) -> None:
        self._name = stream.name
        roles = [a.role for a in stream.arguments]
        self._least = len(roles)
        self._counter = roles.index("counter") if "counter" in roles else None
        self._time = roles.index("time") if "time" in roles else None
        self._whole = [i for i in (self._counter, self._time) if i is not None]
        self._places = [i for i, a in enumerate(stream.arguments) if a in stream.channels]
        self._scale = [a.scale for a in stream.channels]
        times = [a.scale * NS_PER[a.unit] for a in stream.arguments if a.role == "time"]
        self._time_scale = times[0] if times else 1.0
        bits = 32 if self._counter is not None and (stream.rate_hz or self._time is not None) else 0
        self._stamps = Stamps(
            stream.rate_hz, counter_bits=bits, has_time=self._time is not None, latency_s=of.latency_s
        )
        where = f"OSC {stream.address}"
        self._rate = RateCheck(
            where, stream.rate_hz, of.rate_mismatch, setting=f"rate_hz of {stream.name}", counted=bool(bits)
        )

    def take(self, arguments: Sequence[Argument], arrival: int, last: int, feed: Feed) -> int:
        """Emit a message; `last`: the stamp of the last event of `timing`, of which the newest is returned."""
        row = self._row(arguments)
        if isinstance(row, str):
            feed.problem(row)
            return last
        own = counter = None
        if self._time is not None:
            own = round(_number(arguments[self._time]) * self._time_scale)
        if self._counter is not None:
            counter = int(_number(arguments[self._counter])) % (1 << 32)
        made = self._stamps.one(arrival, own, counter)
        if made is None:
            feed.problem("repeated message or wrong time")
            return last
        lost = made.lost
        if lost:
            feed.problem("lost message" if lost > 0 else "device restarted", max(lost, 1))
        if hz := self._rate.see(1, max(lost, 0), arrival, feed, None if own is None else np.array([own])):
            self._stamps.follow(hz)
        record, event = chunks_of_one(made, arrival, np.array([row]), last)
        feed.emit(record, self._name)
        feed.emit(event, "timing")
        return event.until

    def _row(self, arguments: Sequence[Argument]) -> list[float] | str:
        """The channels in their units; or why there are not all of them."""
        if len(arguments) < self._least:
            return "message with too few arguments"
        for i in self._whole:
            if not math.isfinite(_number(arguments[i])):
                return "message with a counter or time that is no number"
        row = []
        for i, scale in zip(self._places, self._scale, strict=True):
            a = arguments[i]
            if not isinstance(a, (int, float)):
                return "message with something else than a number"
            row.append(float(a) * scale)
        return row


def _number(argument: Argument) -> float:
    """NaN for what is not a number."""
    return float(argument) if isinstance(argument, (int, float)) else math.nan
