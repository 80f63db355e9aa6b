"""Any device that sends binary frames of fixed length, declared in the graph: sync bytes, fields, checksum, counter, time."""

from __future__ import annotations

from dataclasses import dataclass

from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy
from kinegraph.devices.clocks.timing import timing_spec
from kinegraph.devices.frames.declared import NS_PER, Frame, hex_bytes
from kinegraph.devices.frames.decoder import FrameDecoder
from kinegraph.devices.frames.layout import FrameLayout
from kinegraph.devices.frames.packet_decoder import EscapedDecoder, Framing, PacketDecoder
from kinegraph.devices.frames.reading import FrameReading
from kinegraph.devices.transport.datagrams import GATHER_HELP, UdpTransport, gathered_s
from kinegraph.devices.transport.serial_source import READ_S, SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import NS, Specs, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, outputs_by_parameters

BY_MESSAGE = ("udp://", "zmq+")
"""Ports of which each read is one message, and to which nothing can be sent."""


@dataclass(frozen=True, slots=True)
class Binary(SerialSource):
    """A device with frames that the graph declares: over a serial port, TCP or Bluetooth LE, as UDP datagrams or ZeroMQ messages, each of
    which is one.

    NAME     (channels,) float64: the data fields of the frame of that name, in their units; an output for each frame with data
    timing   an event per frame: its counter, the device's time, arrival, stamp

    Stamps follow the device's time, which a frame brings itself or has from the last frame that brought one; else the frame's counter
    (with its `rate_hz`); else the arrival. Missing frames are known from the counter, or, with `rate_hz`, from steps of the device's time.
    """

    port: str = param(
        help="/dev/serial/by-id/NAME, COM3, tcp://host:port, ble://DEVICE/NOTIFY[/WRITE] (UUIDs); udp://127.0.0.1:PORT to listen at, "
        "zmq+tcp://host:port to subscribe to; `kinegraph devices` lists what is there"
    )
    frames: tuple[Frame, ...] = param(help="the kinds of frame that the device sends")
    baud: int = param(115200, least=50, help="bits per second of the serial port")
    start: tuple[str, ...] = param((), help="commands in hex, sent one after the other when the port has been opened")
    stop: tuple[str, ...] = param((), help="commands in hex, sent before it is closed")
    framing: Framing = param(
        "none",
        help="slip or cobs: the device escapes its frames, so that one byte alone marks their ends; packet: what carries them does (each "
        "datagram, each Bluetooth notification is one); these need no sync",
    )
    pause_s: float = param(0.05, least=0, most=10, help="how long to wait after each command")
    time_wraps_s: float = param(
        0.0, least=0, help="at which value the device's time wraps around; 0: by the bits of its only field, else never"
    )
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)
    gather_s: float | None = param(None, least=0, most=0.1, help=f"of udp:// ports: {GATHER_HELP}")

    @outputs_by_parameters()
    def outputs(self) -> tuple[str, ...]:
        return (*(f.name for f in self.frames if f.channels), "timing")

    @property
    def chunk_s(self) -> float:
        rates = [f.rate_hz for f in self.frames if f.channels and f.rate_hz]
        return max(*(1 / hz for hz in rates), self.datagrams_s) if rates else self.datagrams_s

    @property
    def datagrams_s(self) -> float:
        """How long datagrams are left to gather before they are read, one after the other."""
        if not self.port.startswith("udp://"):
            return 0.0
        if self.gather_s is not None:
            return self.gather_s
        return gathered_s(f.rate_hz if f.with_role("counter") or f.with_role("time") else None for f in self.frames)

    def specs(self) -> Specs:
        self.layouts()
        self._commands()
        self._check_datagrams()
        specs: Specs = {}
        for f in self.frames:
            if f.channels:
                names, units = tuple(c.name for c in f.channels), tuple(c.unit for c in f.channels)
                specs[f.name] = StreamSpec((len(names),), rate_hz=f.sample_hz, channels=names, units=units)
        return {**specs, "timing": timing_spec()}

    def layouts(self) -> list[FrameLayout]:
        """Every frame's layout; raises ParameterError for a declaration that cannot be."""
        made = [FrameLayout(f, f"frames[{i}]", alone=self._alone) for i, f in enumerate(self.frames)]
        if not any(f.channels for f in self.frames):
            raise ParameterError(
                "frames",
                [f.name for f in self.frames],
                "a list of frames, at least one of which has a named data field",
            )
        for i, f in enumerate(self.frames):
            self._check(f, f"frames[{i}]")
        names = [f.name for f in self.frames if f.channels]
        kinds = [(layout.sync, 0 if layout.sync else layout.size) for layout in made]
        for f, kind in zip(self.frames, kinds, strict=True):
            if f.channels and names.count(f.name) > 1:
                raise ParameterError("frames.name", f.name, "another one for each kind of frame")
            if kinds.count(kind) > 1:
                raise ParameterError("frames.sync", f.sync, "another one for each kind of frame")
        return made

    @property
    def _alone(self) -> bool:
        """Whether what carries the frames marks their ends."""
        return self.framing != "none" or self._by_datagram

    @property
    def _by_datagram(self) -> bool:
        return self.framing == "packet" or self.port.startswith(BY_MESSAGE)

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

    def _check_datagrams(self) -> None:
        """Raise ParameterError for what has no meaning where frames come as datagrams."""
        for name in ("start", "stop"):
            if self.port.startswith(BY_MESSAGE) and getattr(self, name):
                raise ParameterError(
                    name, list(getattr(self, name)), "left out: nothing can be sent back to a sender of datagrams"
                )
        if self.gather_s and not self.port.startswith("udp://"):
            raise ParameterError("gather_s", self.gather_s, "left out: only what comes to a udp:// port is gathered")
        if self._by_datagram and self.framing not in ("none", "packet"):
            raise ParameterError("framing", self.framing, "none: each datagram is a frame")
        if self.framing == "packet" and not self.port.startswith((*BY_MESSAGE, "ble://")):
            raise ParameterError("framing", "packet", "none, slip or cobs: a serial port and TCP know no packets")

    def _commands(self) -> tuple[list[bytes], list[bytes]]:
        return [hex_bytes(text, "start") for text in self.start], [hex_bytes(text, "stop") for text in self.stop]

    @property
    def wraps_ns(self) -> int:
        """At which value the device's time starts again; 0: never."""
        if self.time_wraps_s:
            return round(self.time_wraps_s * NS)
        times = {f.with_role("time") for f in self.frames if f.with_role("time")}
        if len(times) != 1:
            return 0
        (fields,) = times
        if len(fields) != 1 or fields[0].type[0] != "u":
            return 0
        return round((1 << fields[0].bits) * NS_PER[fields[0].unit] * fields[0].scale)

    @property
    def hint(self) -> str:
        """What else may be the reason when no frame comes."""
        return f" (is baud {self.baud} right?)" if "://" not in self.port else ""

    def connect(self) -> Transport:
        if self.port.startswith("udp://"):
            return UdpTransport(self.port, self.datagrams_s)
        return super(Binary, self).connect()

    def greet(self, link: Transport, feed: Feed) -> FrameReading:
        self._send(link, feed, self._commands()[0])
        layouts = self.layouts()
        if self._by_datagram:
            return FrameReading(self, PacketDecoder(layouts))
        return FrameReading(self, EscapedDecoder(layouts, self.framing) if self._alone else FrameDecoder(layouts))

    def fetch(self, link: Transport, heard: float) -> bytes:
        """One datagram is one frame; of all others, what has come."""
        return link.read(READ_S) if self._by_datagram else super(Binary, self).fetch(link, heard)

    def rest(self, link: Transport, feed: Feed) -> None:
        self._send(link, feed, self._commands()[1])

    def _send(self, link: Transport, feed: Feed, commands: list[bytes]) -> None:
        for command in commands:
            link.write(command)
            feed.wait(self.pause_s)
