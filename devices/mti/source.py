"""Xsens/Movella MTi inertial sensors, on a serial port, over TCP or directly on USB."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar, Literal

import structlog

from kinegraph.devices.clocks import tick_clock
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.packet_clock import Packets
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.stamps import chunks, report_losses, report_problems
from kinegraph.devices.clocks.tick_clock import TickClock
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.mti import xbus, xbus_numbers
from kinegraph.devices.mti.xbus import XbusLayout, XbusRun
from kinegraph.devices.mti.xbus_commands import XbusCommands, reason
from kinegraph.devices.transport.handshake import all_there, silence
from kinegraph.devices.transport.serial_source import READ_S, STALL_S, SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

Measure = Literal["acceleration", "angular_velocity", "magnetic_field", "orientation"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """What can be measured: its identifier, that of its high-rate sibling (0: missing), its channels and their unit."""

    identifier: int
    fast: int
    channels: tuple[str, ...]
    unit: str = ""


QUANTITIES: dict[Measure, Quantity] = {
    "acceleration": Quantity(xbus.ACCELERATION, xbus.ACCELERATION_HR, ("ax", "ay", "az"), "m/s2"),
    "angular_velocity": Quantity(xbus.RATE_OF_TURN, xbus.RATE_OF_TURN_HR, ("gx", "gy", "gz"), "rad/s"),
    "magnetic_field": Quantity(xbus.MAGNETIC_FIELD, 0, ("mx", "my", "mz")),
    "orientation": Quantity(xbus.QUATERNION, 0, ("qw", "qx", "qy", "qz")),
}

SILENCE_S = 2.0
"""A sensor that was measuring and says nothing for so long is asked again."""
FEW_HZ = 500.0
"""Above this many packets a second they are read several at a time, and `timing` has an event per read instead of per packet."""
GATHER_S = 0.01
PIECE = 4000
"""A read of a serial port takes all that is there, if that is not more than the system's buffer of 4096 bytes."""
BITS_PER_BYTE = 10
"""On a serial line, with start and stop bit."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Mti(SerialSource):
    """An MTi of the 1, 10, 100 or 600 series, which is set to send what `measure` asks for at `rate_hz`.

    imu      (channels,) float64, in this order: ax ay az m/s2 (gravity included), gx gy gz rad/s, mx my mz (1: the field where it was
             calibrated), qw qx qy qz (unit quaternion from the sensor's frame to the earth's), as far as asked for
    timing   an event per packet (above 500 Hz: per read): counter, device time, arrival, stamp

    A sample is a measurement with everything that was asked for; others (GNSS fixes) are passed over. Stamps follow the sensor's own clock
    (SampleTimeFine, 0.1 ms); lost packets are known from its packet counter. The settings are written to the sensor only where they differ
    from what it has, as it keeps them for good.
    """

    outputs: ClassVar[tuple[str, ...]] = ("imu", "timing")

    port: str = param(
        help="/dev/serial/by-id/NAME, COM3, tcp://host:port, or usb://2639 for direct USB; `kinegraph devices` lists them"
    )
    measure: tuple[Measure, ...] = param(
        ("acceleration", "angular_velocity"),
        help="which of acceleration, angular_velocity, magnetic_field, orientation",
    )
    rate_hz: int = param(100, least=1, most=2000, help="measurements per second; most sensors do up to 400")
    high_rate: bool = param(
        False,
        help="the outputs AccelerationHR and RateOfTurnHR, up to 2000 Hz, not compensated for coning and sculling",
    )
    baud: int = param(115200, least=4800, most=4_000_000, help="as set in the sensor; not used on USB and TCP")
    gather_s: float | None = param(
        None,
        least=0,
        most=0.1,
        help="packets of this time are read at once; left out: as they come, above 500 Hz 10 ms",
    )
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @property
    def chunk_s(self) -> float:
        return max(1 / self.rate_hz, self.gathered_s)

    @property
    def gathered_s(self) -> float:
        if self.gather_s is not None:
            return self.gather_s
        return GATHER_S if self.rate_hz > FEW_HZ else 0.0

    @property
    def wanted(self) -> list[tuple[int, int]]:
        """The outputs (identifier, rate) that the sensor is set to."""
        outputs = [(xbus.PACKET_COUNTER, xbus.EVERY_PACKET), (xbus.SAMPLE_TIME_FINE, xbus.EVERY_PACKET)]
        parts = [QUANTITIES[name] for name in self.ordered]
        return outputs + [(part.fast if self.high_rate else part.identifier, self.rate_hz) for part in parts]

    @property
    def ordered(self) -> list[Measure]:
        return [name for name in QUANTITIES if name in self.measure]

    def specs(self) -> Specs:
        self._check()
        parts = [QUANTITIES[name] for name in self.ordered]
        channels = tuple(channel for part in parts for channel in part.channels)
        units = tuple(part.unit for part in parts for _ in part.channels)
        device = {"device": "Xsens MTi"}
        imu = StreamSpec((len(channels),), rate_hz=float(self.rate_hz), channels=channels, units=units, meta=device)
        return {"imu": imu, "timing": timing_spec()}

    def _check(self) -> None:
        if not self.measure or len(set(self.measure)) != len(self.measure):
            raise ParameterError("measure", list(self.measure), f"some of {', '.join(QUANTITIES)}, each once")
        slow = [name for name in self.ordered if not QUANTITIES[name].fast]
        if self.high_rate and slow:
            raise ParameterError(
                "high_rate",
                True,
                f"false, or {' and '.join(slow)} left out: only acceleration and angular_velocity have it",
            )
        bits = (
            BITS_PER_BYTE
            * self.rate_hz
            * (5 + 5 + 7 + sum(3 + 4 * len(QUANTITIES[name].channels) for name in self.ordered))
        )
        if "://" not in self.port and bits > self.baud:
            raise ParameterError(
                "baud",
                self.baud,
                f"at least {bits}, which {self.rate_hz} measurements a second take (set it in the sensor first)",
            )

    def prepare(self) -> None:
        SerialSource.prepare(self)
        xbus_numbers.prepare()
        tick_clock.prepare()

    def greet(self, link: Transport, feed: Feed) -> MtiReading:
        talk = XbusCommands(link, feed, self.port)
        talk.ask(xbus.GO_TO_CONFIG)
        number = talk.ask(xbus.REQUEST_DEVICE_ID).hex().upper()
        product = talk.ask(xbus.REQUEST_PRODUCT).decode("ascii", "replace").strip(" \0")
        firmware = xbus.firmware(talk.ask(xbus.REQUEST_FIRMWARE))
        feed.identify("Xsens MTi", port=self.port, product=product, serial=number, firmware=firmware)
        if xbus.outputs_of(talk.ask(xbus.OUTPUT_CONFIGURATION)) != self.wanted:
            answer = talk.ask(xbus.OUTPUT_CONFIGURATION, xbus.configuration(self.wanted))
            self._check_outputs(dict(xbus.outputs_of(answer)), product)
        talk.ask(xbus.GO_TO_MEASUREMENT)
        return MtiReading(self, talk)

    def rest(self, link: Transport, feed: Feed) -> None:
        link.write(xbus.message(xbus.GO_TO_CONFIG))

    def _check_outputs(self, there: dict[int, int], product: str) -> None:
        """Raise DeviceError for what the sensor does not do."""
        for identifier, rate in self.wanted:
            got = there.get(identifier, 0)
            if got != rate and rate != xbus.EVERY_PACKET:
                name = next(name for name, part in QUANTITIES.items() if identifier in (part.identifier, part.fast))
                offers = f"{got} Hz" if got else "nothing"
                raise DeviceError(f"{product} on {self.port} was asked for {name} at {rate} Hz and offers {offers}")

    def fetch(self, link: Transport, heard: float) -> bytes:
        data = link.read(READ_S)
        if data and time.monotonic() - heard > STALL_S:
            return all_there(link, data)
        if self.gathered_s and data and (len(data) > PIECE or self.port.startswith("usb://")):
            return _waiting(link, data, self.gathered_s)
        return data


def _waiting(link: Transport, first: bytes, within_s: float) -> bytes:
    """`first` and what else waits: a read of a USB endpoint is one transfer, of which many have come while packets gathered."""
    pieces, deadline = [first], time.monotonic() + within_s
    while time.monotonic() < deadline and (more := link.read(0.0)):
        pieces.append(more)
    return b"".join(pieces)


class MtiReading:
    """Measurements to samples."""

    def __init__(self, of: Mti, talk: XbusCommands) -> None:
        self._port, self._measure = of.port, ", ".join(of.measure)
        self._decoder, self._behind = talk.decoder, talk.behind
        self._clock = TickClock(
            counter_bits=16,
            tick_bits=32,
            tick_ns=NS / xbus.TICKS_HZ,
            rate_hz=of.rate_hz,
            latency_s=of.latency_s,
        )
        self._rate = RateCheck(of.port, of.rate_hz, of.rate_mismatch, counted=True)
        self._kinds = tuple(identifier for identifier, _ in of.wanted[2:])
        self._needed = [identifier for identifier, _ in of.wanted]
        self._layout: XbusLayout | None = None
        """How the last sample was laid out."""
        self._burst = of.rate_hz > FEW_HZ

    @property
    def clock(self) -> ClockState | None:
        return self._clock.state

    def wrong(self, silent_s: float, came: bytes) -> str:
        expected = f"{self._measure} in FA FF 36 ..."
        return silence("measurement", self._port, silent_s, SILENCE_S, expected, came)

    def take(self, data: bytes, feed: Feed) -> int:
        if self._behind:
            self._emit_all(self._behind, feed)
            self._behind = []
        found = self._decoder.feed(data)
        report_problems(feed, bytes_that_are_no_packet=found.dropped, resync=found.resyncs)
        return self._emit_all(found.runs, feed) if found.runs else 0

    def _emit_all(self, found: list[XbusRun], feed: Feed) -> int:
        """Emit measurements, and act on what else came; returns how many samples that was."""
        arrival, n = feed.now(), 0
        for run in found:
            if run.layout is self._layout or (run.mid == xbus.MEASUREMENT and all(map(run.has, self._needed))):
                self._layout = run.layout
                counter, ticks = run.integers(xbus.PACKET_COUNTER), run.integers(xbus.SAMPLE_TIME_FINE)
                packets = self._clock.take(counter, ticks, arrival)
                self._emit(run, packets, arrival, feed)
                n += len(packets.stamp)
            elif run.mid == xbus.MEASUREMENT and run.has(xbus.PACKET_COUNTER):
                self._clock.pass_by(run.integers(xbus.PACKET_COUNTER))
            elif run.mid == xbus.ERROR:
                feed.problem("device error", len(run))
                log.warning("MTi", says=reason(run))
            elif run.mid == xbus.WAKE_UP:
                raise DeviceError("the sensor was restarted, and measures what it did when it left the factory")
        return n

    def _emit(self, run: XbusRun, packets: Packets, arrival: int, feed: Feed) -> None:
        missing = report_losses(packets, feed, "lost packet", "counter reset")
        self._rate.see(len(packets.stamp), missing, arrival, feed)
        if packets.clean:
            feed.emit(Chunk(packets.stamp, run.columns(self._kinds), packets.stamp.item(-1)), "imu")
        else:
            report_problems(feed, repeated_packet=len(run) - len(packets.stamp))
            if not len(packets.stamp):
                return
            data = run.columns(self._kinds)
            if len(packets.stamp) < len(run):
                data = data[packets.kept]
            for chunk in chunks(packets.stamp, packets.lost, data):
                feed.emit(chunk, "imu")
        result = slice(-1, None) if self._burst else slice(None)
        feed.emit(
            timing_chunk(packets.number[result], packets.device[result], arrival, packets.stamp[result]), "timing"
        )
