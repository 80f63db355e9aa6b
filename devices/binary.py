"""Any device that sends binary frames of fixed length, declared in the graph: sync bytes, fields, checksum, counter, time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np
import structlog

from devices.clocks.clock_log import ClockLog
from devices.clocks.device_clock import ClockState, DeviceClock
from devices.clocks.device_time import DeviceTime
from devices.clocks.packet_clock import Packets
from devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from devices.clocks.stamps import REPEATED, Losses, Stamps, runs
from devices.clocks.timing import TIMING, timing_spec
from devices.protocols.checksum_fit import fitting
from devices.protocols.declared import NS_PER, SPOILT, FoundFrames, Frame, FrameDecoder, FrameLayout, hex_bytes
from devices.transport.handshake import all_there, shown
from devices.transport.transport import Transport, connect, present
from stream.chunk import NS, Array, Chunk, Specs, StreamSpec, Times
from stream.errors import DeviceError, ParameterError
from stream.params import param
from stream.source import Feed, Source

FIRST_FRAME_S = 5.0

log = structlog.get_logger(__name__)


class _Outputs:
    """The outputs of a class whose instances have those that they declare."""

    def __get__(self, instance: Binary | None, owner: type) -> tuple[str, ...]:
        return () if instance is None else (*(f.name for f in instance.frames if f.channels), "timing")


@dataclass(frozen=True, slots=True)
class Binary(Source):
    """A device whose frames the graph declares, over a serial port or TCP.

    NAME     (channels,) float64: the data fields of the frame of that name, in their units; an output for each frame with data
    timing   an event per frame: its counter, the device's time, arrival, stamp

    Stamps follow the device's time, which a frame brings itself or has from the last frame that brought one; else the frame's counter
    (with its `rate_hz`); else the arrival. Missing frames are known from the counter, or, with `rate_hz`, from steps of the device's time.
    """

    outputs = _Outputs()

    port: str = param(help="/dev/serial/by-id/NAME, COM3 or tcp://host:port; `kinegraph devices` lists serial ports")
    frames: tuple[Frame, ...] = param(help="the kinds of frame that the device sends")
    baud: int = param(115200, least=50, help="bits per second of the serial port")
    start: tuple[str, ...] = param((), help="commands in hex, sent one after the other when the port has been opened")
    stop: tuple[str, ...] = param((), help="commands in hex, sent before it is closed")
    pause_s: float = param(0.05, least=0, most=10, help="how long to wait after each command")
    time_wraps_s: float = param(
        0.0, least=0, help="at which value the device's time begins anew; 0: by the bits of its only field, else never"
    )
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @property
    def chunk_s(self) -> float:
        return max((1 / f.rate_hz for f in self.frames if f.channels and f.rate_hz), default=0.0)

    def specs(self) -> Specs:
        self.layouts()
        self._commands()
        specs: Specs = {}
        for f in self.frames:
            if f.channels:
                names, units = tuple(c.name for c in f.channels), tuple(c.unit for c in f.channels)
                specs[f.name] = StreamSpec((len(names),), rate_hz=f.rate_hz, channels=names, units=units)
        return {**specs, "timing": timing_spec()}

    def layouts(self) -> list[FrameLayout]:
        """Every frame's layout; raises ParameterError for a declaration that cannot be."""
        made = [FrameLayout(f, f"frames[{i}]") for i, f in enumerate(self.frames)]
        if not any(f.channels for f in self.frames):
            raise ParameterError(
                "frames",
                [f.name for f in self.frames],
                "a list of frames, at least one of which has a named data field",
            )
        for i, f in enumerate(self.frames):
            self._check(f, f"frames[{i}]")
        for what in ("name", "sync"):
            given = [getattr(f, what) for f in self.frames if what == "sync" or f.channels]
            twice = [value for value in given if given.count(value) > 1]
            if twice:
                raise ParameterError(f"frames.{what}", twice[0], "another one for each kind of frame")
        return made

    def _check(self, f: Frame, at: str) -> None:
        names = [c.name for c in f.channels]
        if f.channels and (not f.name.isidentifier() or f.name == "timing"):
            raise ParameterError(f"{at}.name", f.name, "letters, digits and '_', and not 'timing': it names an output")
        if len(set(names)) != len(names):
            raise ParameterError(f"{at}.fields", names, "fields of different names")
        counters = f.with_role("counter")
        if len(counters) > 1 or any(c.type[0] != "u" or c.bits > 32 for c in counters):
            raise ParameterError(f"{at}.fields", [c.type for c in counters], "at most one counter, of type u8 to u32")
        if counters and not f.rate_hz and not f.with_role("time"):
            raise ParameterError(f"{at}.rate_hz", None, "given, where a counter is the frame's only clock")
        for c in f.with_role("time"):
            if c.unit not in NS_PER:
                raise ParameterError(f"{at}.fields", c.unit, f"for a time: a unit out of {', '.join(NS_PER)}")

    def _commands(self) -> tuple[list[bytes], list[bytes]]:
        return [hex_bytes(text, "start") for text in self.start], [hex_bytes(text, "stop") for text in self.stop]

    @property
    def wraps_ns(self) -> int:
        """At which value the device's time begins anew; 0: never."""
        if self.time_wraps_s:
            return round(self.time_wraps_s * NS)
        times = {f.with_role("time") for f in self.frames if f.with_role("time")}
        if len(times) != 1:
            return 0
        (fields,) = times
        if len(fields) != 1 or fields[0].type[0] != "u":
            return 0
        return round((1 << fields[0].bits) * NS_PER[fields[0].unit] * fields[0].scale)

    @contextmanager
    def simulated(self) -> Iterator[Source]:
        from devices.simulators.binary import BinaryModel, serving

        with serving(BinaryModel(self)) as address:
            yield replace(self, port=address)

    def present(self) -> bool | None:
        return present(self.port)

    def read(self, feed: Feed) -> None:
        start, stop = self._commands()
        with self._connect() as link:
            self._identify(link, feed)
            self._send(link, feed, start)
            try:
                self._stream(link, feed)
            finally:
                with suppress(DeviceError):
                    self._send(link, feed, stop)

    def _connect(self) -> Transport:
        return connect(self.port, self.baud)

    def _identify(self, link: Transport, feed: Feed) -> None:
        """Frames that a graph declares say nothing of who sends them."""

    def _decoder(self, layouts: list[FrameLayout]) -> FrameDecoder:
        return FrameDecoder(layouts)

    def _taken(self, link: Transport, timeout_s: float) -> bytes:
        """What is there; after a stall, all of it."""
        data = link.read(timeout_s)
        return all_there(link, data) if len(data) > 1000 else data

    def _send(self, link: Transport, feed: Feed, commands: list[bytes]) -> None:
        for command in commands:
            link.write(command)
            feed.wait(self.pause_s)

    def _stream(self, link: Transport, feed: Feed) -> None:
        layouts = self.layouts()
        decoder, stream = self._decoder(layouts), _Stream(self, layouts)
        opened, seen, came = time.monotonic(), False, b""
        spoilt: deque[tuple[int, bytes]] = deque(maxlen=SPOILT)
        clock_log = ClockLog(self.port, feed, lambda: stream.clock)
        while not feed.stopped:
            data = self._taken(link, 0.1)
            found = decoder.feed(data)
            stream.pass_on(found, feed)
            clock_log.tell()
            for kind, count in (
                ("bad checksum", found.bad), ("bytes that are no frame", found.dropped), ("resync", found.resyncs)
            ):  # fmt: skip
                if count:
                    feed.problem(kind, count)
            seen = seen or bool(found.kinds)
            came = b"" if seen else (came + data)[-64:]
            spoilt.extend(found.spoilt if not seen else ())
            if came and not seen and time.monotonic() - opened > FIRST_FRAME_S:
                syncs = " or ".join(layout.sync.hex(" ") for layout in layouts)
                raise DeviceError(
                    f"no frame from {self.port} within {FIRST_FRAME_S:g} s: expected {syncs} and a right checksum; came {shown(came)}"
                    + _fits(spoilt, layouts)
                    + (f" (is baud {self.baud} right?)" if "://" not in self.port else "")
                )


def _fits(spoilt: Iterable[tuple[int, bytes]], layouts: list[FrameLayout]) -> str:
    """For the error's end: which checksums would fit the frames that came."""
    by_kind: dict[int, list[bytes]] = {}
    for kind, frame in spoilt:
        by_kind.setdefault(kind, []).append(frame)
    told = [f"frames[{kind}]: {text}" for kind, frames in by_kind.items() if (text := fitting(frames, layouts[kind]))]
    return f"; {', '.join(told)}" if told else ""


class _Stream:
    """Frames to samples: what is remembered between two reads."""

    def __init__(self, of: Binary, layouts: list[FrameLayout]) -> None:
        self._layouts = layouts
        self._clock = DeviceClock(of.latency_s)
        self._time = DeviceTime(self._clock, of.wraps_ns)
        self._now: int | None = None
        """The device's time by the last frame that brought one."""
        self._timed = any(f.with_role("time") for f in of.frames)
        bits = [c[0].bits if (c := f.with_role("counter")) else 0 for f in of.frames]
        self._losses = [Losses(f.rate_hz, b) for f, b in zip(of.frames, bits, strict=True)]
        self._stamps = [
            Stamps(f.rate_hz, counter_bits=b, latency_s=of.latency_s) for f, b in zip(of.frames, bits, strict=True)
        ]
        self._rates = [
            RateCheck(of.port, f.rate_hz, of.rate_mismatch, setting=f"frames[{i}].rate_hz", counted=bool(b))
            for i, (f, b) in enumerate(zip(of.frames, bits, strict=True))
        ]
        self._last = 0

    @property
    def clock(self) -> ClockState | None:
        """What is known of the device's clock; None if frames bring no time."""
        return self._clock.state if self._timed else None

    def pass_on(self, found: FoundFrames, feed: Feed) -> None:
        """Emit what a read has brought."""
        if not found.kinds:
            return
        arrival = feed.now()
        tables = {kind: self._layouts[kind].table(bytes(frames)) for kind, frames in found.frames.items()}
        if self._timed:
            packets = self._by_time(np.array(found.kinds), tables, arrival, feed)
        else:
            packets = {}
            for kind, table in tables.items():
                counters = self._layouts[kind].counters(table)
                packets[kind] = self._stamps[kind].take(len(table), arrival, None, counters)
        for kind, table in tables.items():
            self._check_rate(kind, table, packets[kind], arrival, feed)
            self._emit(kind, table, packets[kind], feed)
        self._tell_timing(packets, arrival, feed)

    def _check_rate(self, kind: int, table: Array, packets: Packets, arrival: int, feed: Feed) -> None:
        layout = self._layouts[kind]
        counted = bool(layout.frame.with_role("counter"))
        missing = int(packets.lost.clip(0).sum()) if counted else 0
        hz = self._rates[kind].see(len(packets.stamp), missing, arrival, feed, layout.times_ns(table))
        if hz:
            self._stamps[kind].follow(hz)
            self._losses[kind].follow(hz)

    def _by_time(self, kinds: Array, tables: dict[int, Array], arrival: int, feed: Feed) -> dict[int, Packets]:
        """Frames in the order in which they came get the device's time, all through one mapping."""
        raw = {kind: self._layouts[kind].times_ns(table) for kind, table in tables.items()}
        counters = {kind: self._layouts[kind].counters(table) for kind, table in tables.items()}
        seen = dict.fromkeys(tables, 0)
        device, lost, number, stamp = np.full((4, len(kinds)), -1, np.int64)
        mapped = 0
        kept = np.zeros(len(kinds), bool)
        for i, kind in enumerate(kinds.tolist()):
            place, seen[kind] = seen[kind], seen[kind] + 1
            own, restarted = raw[kind], False
            if own is not None:
                self._now = self._time.read(int(own[place]), arrival)
                restarted = self._time.restarted
                if restarted:
                    self._clock.map(device[mapped:i], kept[mapped:i], arrival, stamp[mapped:i])
                    self._clock.restart(self._time.jump_ns)
                    mapped = i
                    feed.problem("device restarted")
            if self._now is None:
                continue
            count = counters[kind]
            lost[i] = self._losses[kind].before(
                self._now, None if count is None else int(count[place]), arrival, restarted
            )
            device[i], number[i], kept[i] = self._now, self._losses[kind].number, lost[i] > REPEATED
        self._clock.map(device[mapped:], kept[mapped:], arrival, stamp[mapped:])
        packets = {}
        for kind in tables:
            here = kinds == kind
            good = here & kept
            packets[kind] = Packets(kept[here], number[good], lost[good], device[good], stamp[good])
        return packets

    def _emit(self, kind: int, table: Array, packets: Packets, feed: Feed) -> None:
        left_out = len(table) - len(packets.stamp)
        if left_out:
            feed.problem("repeated frame or wrong time", left_out)
        missing = int(packets.lost.clip(0).sum())
        if missing:
            feed.problem("lost frame", missing)
        frame = self._layouts[kind].frame
        if not frame.channels or not len(packets.stamp):
            return
        data = self._layouts[kind].values(table[packets.kept])
        for start, stop in runs(packets.lost):
            times = packets.stamp[start:stop]
            feed.emit(Chunk(times, data[start:stop], int(times[-1]), int(packets.lost[start])), frame.name)

    def _tell_timing(self, packets: dict[int, Packets], arrival: int, feed: Feed) -> None:
        """All kinds of frame in one stream, in the order of their stamps."""
        events = np.empty(sum(len(p.stamp) for p in packets.values()), TIMING)
        if not len(events):
            return
        for name, column in (("counter", "number"), ("device", "device"), ("stamp", "stamp")):
            events[name] = np.concatenate([getattr(p, column) for p in packets.values()])
        events["arrival"] = arrival
        events = events[np.argsort(events["stamp"], kind="stable")]
        times: Times = np.maximum(events["stamp"], self._last)
        self._last = int(times[-1])
        feed.emit(Chunk(times, events, self._last), "timing")
