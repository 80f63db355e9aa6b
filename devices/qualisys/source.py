"""Qualisys Track Manager, live by its real-time protocol: labelled markers, rigid bodies, segments of skeletons, analog channels."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.stamps import Stamps, chunks, report_losses
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.qualisys import protocol as protocol
from kinegraph.devices.qualisys.protocol import (
    PORT,
    AnalogDevice,
    AnalogSamples,
    QualisysDecoder,
    QualisysError,
    QualisysFrame,
    QualisysNames,
)
from kinegraph.devices.transport.transport import TcpTransport, unreachable
from kinegraph.stream.chunk import Samples, Specs, StreamSpec
from kinegraph.stream.domain.axes import Axes, Up
from kinegraph.stream.errors import DeviceError, ParameterError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters

ANSWER_S = 3.0
SAME_RATE = 0.01


@dataclass(frozen=True, slots=True)
class Qualisys(Source):
    """Qualisys Track Manager (QTM) in the local network, while it captures or plays back with real-time output.

    markers     (m, 3) float64 at `rate_hz`: the named markers in m; NaN: not seen
    bodies      (b, 3) float64: positions of the named rigid bodies in m
    rotations   (b, 9) float64: their rotations, nine numbers in the order in which QTM sends them
    segments            (s, 3) float64: positions of the named skeletons' segments in m, in the laboratory's axes; NaN: not solved
    segment_rotations   (s, 4) float64: their rotations, quaternions x, y, z, w
    analog      (c,) float64 at `analog_hz`: channels of one analog device, in `analog_unit`
    timing      an event per frame: its number, QTM's time, arrival, stamp

    QTM's axes are kept; `up` declares which of them points up, and is compared with what QTM says. Stamps follow QTM's time, missing
    frames are known from their number; analog samples have running numbers of their own, and come in bursts. Source: Qualisys' protocol
    documentation 1.20.
    """

    server: str = param("127.0.0.1", help="the computer on which QTM runs")
    markers: tuple[str, ...] = param((), help="labelled markers, as QTM names them")
    bodies: tuple[str, ...] = param((), help="rigid bodies, as QTM names them")
    segments: tuple[str, ...] = param((), help="segments of skeletons: Fred:Hips, Fred:Spine, ...")
    analog: tuple[str, ...] = param(
        (), help="analog channels, as QTM labels them; Device:Label where a label is not unique"
    )
    analog_hz: float = param(1000.0, above=0, most=1_000_000, help="analog samples per second, as set in QTM")
    analog_unit: str = param("V", help="the unit of the analog channels")
    rate_hz: float = param(100.0, above=0, most=10_000, help="frames per second, as set in QTM")
    up: Up = param("z", help="the axis that points up, as QTM was calibrated")
    port: int = param(PORT, least=1, most=65535, help="QTM's little-endian port")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the exposure to the arrival, if you know it"
    )

    @outputs_by_parameters("markers", "timing")
    def outputs(self) -> tuple[str, ...]:
        wanted = (
            (self.markers, ("markers",)),
            (self.bodies, ("bodies", "rotations")),
            (self.segments, ("segments", "segment_rotations")),
            (self.analog, ("analog",)),
        )
        return (*(output for given, outputs in wanted if given for output in outputs), "timing")

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz

    def specs(self) -> Specs:
        if not (self.markers or self.bodies or self.segments or self.analog):
            raise ParameterError("markers", [], "at least one of markers, bodies, segments, analog")
        for name in ("markers", "bodies", "segments", "analog"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ParameterError(name, list(getattr(self, name)), "different names")
        for name in self.segments:
            if ":" not in name:
                raise ParameterError("segments", name, "the skeleton's name and the segment's: Fred:Hips")
        specs: Specs = {"timing": timing_spec()}
        device = {"device": "Qualisys"}
        for output, names, width, unit, rotation in (
            ("markers", self.markers, 3, "m", ""), ("bodies", self.bodies, 3, "m", ""), ("rotations", self.bodies, 9, "", "matrix"),
            ("segments", self.segments, 3, "m", ""), ("segment_rotations", self.segments, 4, "", "xyzw"),
        ):  # fmt: skip
            if names:
                meta = {**device, "axes": Axes(self.up).facts(), **({"rotation": rotation} if rotation else {})}
                specs[output] = StreamSpec(
                    (len(names), width), rate_hz=self.rate_hz, channels=names, units=(unit,), meta=meta
                )
        if self.analog:
            specs["analog"] = StreamSpec(
                (len(self.analog),),
                rate_hz=self.analog_hz,
                channels=self.analog,
                units=(self.analog_unit,),
                meta=device,
            )
        return specs

    def missing(self) -> str:
        return unreachable(f"tcp://{self.server}:{self.port}")

    def prepare(self) -> None:
        line_below.prepare()

    def read(self, feed: Feed) -> None:
        with TcpTransport(f"tcp://{self.server}:{self.port}") as link:
            talk = QualisysSession(link, feed)
            talk.expect(protocol.COMMAND, "")
            talk.ask(f"version {protocol.VERSION}", protocol.COMMAND, "Version set to")
            wanted = (self.markers, self.bodies, self.segments, self.analog)
            asked = [part for part, names in zip(("3d", "6d", "skeleton", "analog"), wanted, strict=True) if names]
            known = protocol.names(talk.ask(f"getparameters general {' '.join(asked)}", protocol.XML, "<"))
            if known.rate_hz and abs(known.rate_hz / self.rate_hz - 1) > SAME_RATE:
                raise DeviceError(
                    f"QTM captures at {known.rate_hz:g} Hz, not {self.rate_hz:g}; write rate_hz: {known.rate_hz:g}"
                )
            if known.up and known.up != self.up:
                raise DeviceError(f"in QTM {known.up} points up, not {self.up}; write up: {known.up}")
            feed.identify(
                "Qualisys QTM", server=self.server, markers=float(len(known.markers)), bodies=float(len(known.bodies))
            )
            reading = QualisysReading(self, known)
            parts = " ".join(asked).replace("skeleton", "skeleton:global")
            link.write(protocol.command(f"streamframes allframes {parts}"))
            feed.ready()
            try:
                with ClockLog(f"QTM {self.server}", feed, lambda: reading.stamps.state) as clock_log:
                    while not feed.stopped:
                        for kind, payload in talk.packets():
                            reading.take(kind, payload, feed)
                        clock_log.tell()
            finally:
                with suppress(DeviceError):
                    link.write(protocol.command("streamframes stop"))


class QualisysSession:
    """Commands and their answers."""

    def __init__(self, link: TcpTransport, feed: Feed) -> None:
        self._link, self._feed, self._decoder = link, feed, QualisysDecoder()

    def packets(self) -> list[tuple[int, bytes]]:
        """What has come within a tenth of a second; raises DeviceError."""
        try:
            return self._decoder.feed(self._link.read(0.1))
        except QualisysError as error:
            raise DeviceError(f"{self._link.address}: {error}") from None

    def ask(self, text: str, kind: int, begins: str) -> str:
        self._link.write(protocol.command(text))
        return self.expect(kind, begins, text)

    def expect(self, kind: int, begins: str, asked: str = "a connection") -> str:
        """The text of the next packet of that kind; raises DeviceError."""
        deadline = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline and not self._feed.stopped:
            for came, payload in self.packets():
                reply = protocol.text_of(payload)
                if came == kind and reply.startswith(begins):
                    return reply
                if came in (protocol.ERROR, kind):
                    raise DeviceError(f"QTM answers {reply!r} to {asked!r}")
        raise DeviceError(f"{self._link.address} does not answer {asked!r}; is QTM's real-time output on?")


class QualisysReading:
    """Packets to chunks. Raises DeviceError for a name that QTM does not have."""

    def __init__(self, of: Qualisys, known: QualisysNames) -> None:
        self._of = of
        self.stamps = Stamps(of.rate_hz, counter_bits=32, has_time=True, latency_s=of.latency_s)
        self._markers = [_place(known.markers, name, "marker") for name in of.markers]
        self._bodies = [_place(known.bodies, name, "rigid body") for name in of.bodies]
        self._segments = [_segment(known, name) for name in of.segments]
        self._analog = QualisysAnalog(of, known.analog) if of.analog else None

    def take(self, kind: int, payload: bytes, feed: Feed) -> None:
        if kind != protocol.DATA:
            feed.problem("capture has ended") if kind == protocol.NO_MORE else None
            return
        try:
            frame = protocol.frame(payload)
        except QualisysError:
            feed.problem("cut frame")
            return
        arrival = feed.now()
        if self._analog:
            self._analog.take(frame.analog, arrival, feed)
        packets = self.stamps.take(1, arrival, np.array([frame.time_us * 1000]), np.array([frame.number]))
        if not len(packets.stamp):
            feed.problem("repeated frame or wrong time")
            return
        if lost := int(packets.lost[0]):
            feed.problem("lost frame" if lost > 0 else "device restarted", max(lost, 1))
        for output, row in self._rows(frame).items():
            for chunk in chunks(packets.stamp, packets.lost, row[None]):
                feed.emit(chunk, output)
        feed.emit(timing_chunk(packets.number, packets.device, arrival, packets.stamp), "timing")

    def _rows(self, frame: QualisysFrame) -> dict[str, Samples]:
        made: dict[str, Samples] = {}
        if self._markers:
            made["markers"] = _chosen(frame.markers, self._markers) / 1000
        if self._bodies:
            rows = _chosen(frame.bodies, self._bodies)
            made["bodies"], made["rotations"] = rows[:, :3] / 1000, np.ascontiguousarray(rows[:, 3:])
        if self._segments:
            rows = np.full((len(self._segments), 7), np.nan)
            for i, (skeleton, number) in enumerate(self._segments):
                if skeleton < len(frame.skeletons) and number in frame.skeletons[skeleton]:
                    rows[i] = frame.skeletons[skeleton][number]
            made["segments"], made["segment_rotations"] = rows[:, :3] / 1000, np.ascontiguousarray(rows[:, 3:])
        return made


class QualisysAnalog:
    """The named channels of one analog device, on the clock of its running sample number."""

    def __init__(self, of: Qualisys, devices: list[AnalogDevice]) -> None:
        """Raises DeviceError for a channel that QTM does not have, another rate or unit, and channels of several devices."""
        places = {
            name: (device, k)
            for device in reversed(devices)
            for k, label in enumerate(device.channels)
            for name in (label, f"{device.name}:{label}")
        }
        for name in of.analog:
            if name not in places:
                raise DeviceError(f"QTM has no analog channel {name!r}; {nearest(name, [*places])}")
        found = [places[name] for name in of.analog]
        self._device, self._channels = found[0][0], [k for _, k in found]
        device = self._device
        if any(other is not device for other, _ in found):
            names = sorted({other.name for other, _ in found})
            raise DeviceError(f"the analog channels are of several devices ({', '.join(names)}); write a node for each")
        if device.rate_hz and abs(device.rate_hz / of.analog_hz - 1) > SAME_RATE:
            raise DeviceError(
                f"{device.name} samples at {device.rate_hz:g} Hz, not {of.analog_hz:g}; write analog_hz: {device.rate_hz:g}"
            )
        units = {device.units[k] for k in self._channels if device.units[k]}
        if units and units != {of.analog_unit}:
            raise DeviceError(
                f"{device.name} gives {', '.join(sorted(units))}, not {of.analog_unit}; write it as analog_unit"
            )
        self._stamps = Stamps(of.analog_hz, counter_bits=32, latency_s=of.latency_s)

    def take(self, blocks: list[AnalogSamples], arrival: int, feed: Feed) -> None:
        for block in blocks:
            if block.device != self._device.number:
                continue
            if block.values.shape[1] <= max(self._channels):
                feed.problem("cut frame")
                continue
            n = len(block.values)
            packets = self._stamps.take(n, arrival, None, block.first + np.arange(n))
            report_losses(packets, feed, "lost analog sample", "device restarted")
            values = block.values[packets.kept][:, self._channels].astype(np.float64)
            for chunk in chunks(packets.stamp, packets.lost, values):
                feed.emit(chunk, "analog")


def _chosen(rows: np.ndarray, places: list[int]) -> Samples:
    """Those rows; NaN for one that a frame does not have."""
    made = np.full((len(places), rows.shape[1]), np.nan)
    for i, place in enumerate(places):
        if place < len(rows):
            made[i] = rows[place]
    return made


def _segment(known: QualisysNames, name: str) -> tuple[int, int]:
    """The skeleton's place and the segment's number."""
    skeleton, _, segment = name.partition(":")
    place = _place([*known.skeletons], skeleton, "skeleton")
    segments = known.skeletons[skeleton]
    _place([*segments], segment, f"segment of {skeleton}")
    return place, segments[segment]


def _place(known: list[str], name: str, what: str) -> int:
    if name not in known:
        raise DeviceError(f"QTM streams no {what} {name!r}; {nearest(name, known)}")
    return known.index(name)
