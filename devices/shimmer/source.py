"""Shimmer3 with the LogAndStream firmware over Bluetooth's serial port: accelerometers, gyroscope, EMG or ECG."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import structlog

from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.stamps import Stamps, chunks, report_losses, report_problems
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.shimmer import protocol as protocol
from kinegraph.devices.shimmer import units as units
from kinegraph.devices.shimmer.commands import ShimmerCommands
from kinegraph.devices.shimmer.protocol import TICKS_HZ, Inquiry, ShimmerDecoder
from kinegraph.devices.shimmer.units import Chips
from kinegraph.devices.transport.handshake import silence
from kinegraph.devices.transport.serial_source import SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import NS, Samples, Specs, StreamSpec
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, outputs_by_parameters

Sensor = Literal["acceleration", "wide_acceleration", "angular_velocity", "emg", "ecg"]
MOTION: dict[str, tuple[tuple[str, ...], str]] = {
    "acceleration": (("ax", "ay", "az"), "m/s2"),
    "wide_acceleration": (("wx", "wy", "wz"), "m/s2"),
    "angular_velocity": (("gx", "gy", "gz"), "rad/s"),
}
EXG: dict[str, dict[str, str]] = {
    "emg": {"emg1": "exg1", "emg2": "exg2"},
    "ecg": {"LL-RA": "exg1", "LA-RA": "exg2", "Vx-RL": "exg4"},
}
"""Per purpose: the channels, and which of the chips' they are."""

SILENCE_S = 2.0
BATTERY_S = 60.0
LOW_BATTERY_V = 3.6

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Shimmer(SerialSource):
    """A Shimmer3 that sends what `sensors` asks for at `rate_hz`.

    motion   (channels,) float64, in this order: ax ay az m/s2 (low noise, +-2 g), wx wy wz m/s2 (wide range), gx gy gz rad/s, by the
             calibration that the device keeps, as far as asked for
    exg      (2,) float64 for emg, (3,) for ecg: uV at the electrodes
    timing   an event per packet: device time, arrival, stamp; there is no counter

    A packet has neither checksum nor counter: lost ones are known by the steps of the device's time (1/32768 s), and a byte that was
    changed on the way shows only if it is the time's. Rates are 32768 Hz divided by a whole number; the nearest to `rate_hz` is taken.
    """

    port: str = param(help="/dev/rfcomm0 or COM3; `kinegraph devices` lists serial ports")
    sensors: tuple[Sensor, ...] = param(
        ("acceleration", "angular_velocity"),
        help="which of acceleration, wide_acceleration, angular_velocity, and emg or ecg",
    )
    rate_hz: float = param(204.8, least=1, most=1024, help="packets per second")
    wide_range_g: Literal[2, 4, 8, 16] = param(8, help="the wide-range accelerometer's")
    gyro_range_dps: Literal[250, 500, 1000, 2000] = param(500, help="the gyroscope's, degrees a second")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @outputs_by_parameters("motion", "exg", "timing")
    def outputs(self) -> tuple[str, ...]:
        asked = ["motion"] * bool(self.motion) + ["exg"] * bool(self.purpose)
        return (*asked, "timing")

    @property
    def chunk_s(self) -> float:
        return 1 / self.true_hz

    @property
    def true_hz(self) -> float:
        """The rate that the device can do."""
        return TICKS_HZ / protocol.divider(self.rate_hz)

    @property
    def motion(self) -> list[str]:
        """The sensors of the output `motion`, in its order."""
        return [name for name in MOTION if name in self.sensors]

    @property
    def purpose(self) -> str:
        """What the ExG chips are for; "": nothing."""
        return next((name for name in EXG if name in self.sensors), "")

    def specs(self) -> Specs:
        if not self.sensors or len(set(self.sensors)) != len(self.sensors) or {"emg", "ecg"} <= set(self.sensors):
            raise ParameterError(
                "sensors", list(self.sensors), f"some of {', '.join(MOTION)}, and one of emg, ecg; each once"
            )
        device, specs = {"device": "Shimmer3"}, {"timing": timing_spec()}
        if self.motion:
            names = tuple(channel for sensor in self.motion for channel in MOTION[sensor][0])
            unit = tuple(MOTION[sensor][1] for sensor in self.motion for _ in range(3))
            specs["motion"] = StreamSpec((len(names),), rate_hz=self.true_hz, channels=names, units=unit, meta=device)
        if self.purpose:
            names = tuple(EXG[self.purpose])
            specs["exg"] = StreamSpec((len(names),), rate_hz=self.true_hz, channels=names, units=("uV",), meta=device)
        return specs

    @property
    def bits(self) -> int:
        """The sensors as the device receives them."""
        chips = {"emg": ("exg1",), "ecg": ("exg1", "exg2")}.get(self.purpose, ())
        return sum(protocol.SENSOR_BITS[name] for name in (*self.motion, *chips))

    @property
    def expected(self) -> set[str]:
        """The channels that the device must send then."""
        chips = {"emg": 1, "ecg": 2}.get(self.purpose, 0)
        exg = {
            name for chip in range(chips) for name in (f"status{chip + 1}", f"exg{2 * chip + 1}", f"exg{2 * chip + 2}")
        }
        return {channel for sensor in self.motion for channel in MOTION[sensor][0]} | exg

    def greet(self, link: Transport, feed: Feed) -> ShimmerReading:
        talk = ShimmerCommands(link, feed, self.port)
        talk.rest()
        version = talk.ask(bytes([protocol.FIRMWARE]), protocol.VERSION, 6)
        kind, numbers = int.from_bytes(version[:2], "little"), (int.from_bytes(version[2:4], "little"), *version[4:])
        if kind != protocol.LOG_AND_STREAM or numbers < (0, 5, 4):
            text = ".".join(map(str, numbers))
            raise DeviceError(
                f"{self.port}: expected the firmware LogAndStream (3), 0.5.4 or later; it has firmware {kind}, {text}"
            )
        made = talk.ask(bytes([protocol.HARDWARE]), protocol.MADE, 1)[0]
        if made != protocol.SHIMMER3:
            kind_of = protocol.MODELS.get(made, f"hardware {made}")
            raise DeviceError(f"{self.port}: expected a Shimmer3; it is a {kind_of}, which sends its numbers otherwise")
        name = talk.ask(bytes([protocol.NAME]), protocol.NAMED, 0)[1:].decode("ascii", "replace")
        volts = protocol.battery_v(talk.ask(bytes([protocol.BATTERY]), protocol.CHARGED, 3))
        board = talk.ask(bytes([protocol.BOARD, 3, 0]), protocol.BOARDED, 0)[1:]
        message = "unknown" if board[0] == 0xFF else f"SR{board[0]}-{board[1]}-{board[2]}"
        firmware, chips = "LogAndStream " + ".".join(map(str, numbers)), units.chips_of(board)
        feed.identify(
            "Shimmer3", port=self.port, name=name, firmware=firmware, board=message, battery_v=round(volts, 2)
        )
        for command in self._settings(chips):
            talk.ask(command, protocol.ACK, 0)
        inquiry = protocol.inquiry(talk.ask(bytes([protocol.INQUIRY]), protocol.INQUIRED, -1))
        offered = {c.name if (c := protocol.CHANNELS.get(n)) else f"{n:#04x}" for n in inquiry.channels}
        if offered != self.expected or inquiry.divider != protocol.divider(self.rate_hz):
            raise DeviceError(
                f"{self.port} was asked for {', '.join(sorted(self.expected))} every {protocol.divider(self.rate_hz)} ticks "
                f"and offers {', '.join(sorted(offered)) or 'nothing'} every {inquiry.divider}"
            )
        calibration = talk.ask(bytes([protocol.CALIBRATION]), protocol.CALIBRATED, units.ALL)
        link.write(bytes([protocol.START]))
        return ShimmerReading(self, link, inquiry, calibration, chips)

    def rest(self, link: Transport, feed: Feed) -> None:
        link.write(bytes([protocol.STOP]))

    def _settings(self, chips: Chips) -> Iterator[bytes]:
        """The commands that set what is wanted."""
        yield bytes([protocol.SENSORS]) + self.bits.to_bytes(3, "little")
        yield bytes([protocol.RATE]) + protocol.divider(self.rate_hz).to_bytes(2, "little")
        if "wide_acceleration" in self.sensors:
            yield bytes([protocol.WIDE_RANGE, chips.wide_g.index(self.wide_range_g)])
            yield bytes([protocol.WIDE_RATE, chips.wide_rate(self.true_hz)])
        if "angular_velocity" in self.sensors:
            yield bytes([protocol.GYRO_RANGE, units.GYRO_DPS.index(self.gyro_range_dps)])
            yield bytes([protocol.GYRO_RATE, units.gyro_divider(self.true_hz)])
        if self.purpose:
            for chip, registers in enumerate(units.registers(self.purpose, self.true_hz)):
                yield bytes([protocol.EXG, chip, 0, len(registers)]) + registers


class ShimmerReading:
    """Packets to samples, and the battery's voltage once a minute."""

    def __init__(self, of: Shimmer, link: Transport, inquiry: Inquiry, calibration: bytes, chips: Chips) -> None:
        self._link, self._asked = link, time.monotonic()
        self._decoder = ShimmerDecoder(inquiry.channels, inquiry.divider)
        self._patience_s = SILENCE_S + 2 * protocol.AGREE / of.true_hz
        wraps = round(protocol.TICKS * NS / TICKS_HZ)
        self._stamps = Stamps(of.true_hz, has_time=True, wraps_ns=wraps, latency_s=of.latency_s)
        self._rate = RateCheck(of.port, of.true_hz, of.rate_mismatch)
        self._channels, self._port = inquiry.channels, of.port
        ranges = (inquiry.wide_range, inquiry.gyro_range, chips)
        self._motion = {name: units.calibration(calibration, name, *ranges) for name in of.motion}
        if nominal := [name for name, known in self._motion.items() if not known.own]:
            log.warning(
                "not calibrated for this range; the data sheet's numbers are used", sensors=nominal, port=of.port
            )
        self._exg = list(EXG.get(of.purpose, {}).values())
        if of.purpose:
            places = [int(name[-1]) - 1 for name in self._exg]
            self._uv = units.exg_uv(of.purpose, 4)[places]

    @property
    def clock(self) -> ClockState | None:
        return self._stamps.state

    def wrong(self, silent_s: float, came: bytes) -> str:
        expected = f"{self._decoder.size} bytes from 00 on"
        return silence("packet", self._port, silent_s, self._patience_s, expected, came)

    def take(self, data: bytes, feed: Feed) -> int:
        found = self._decoder.feed(data)
        report_problems(
            feed, bytes_that_are_no_packet=found.dropped, resync=found.resyncs, repeated_packet=found.repeated
        )
        for level in found.battery:
            self._report_battery(protocol.battery_v(level), feed)
        if len(found):
            self._emit(found, feed)
        if time.monotonic() - self._asked > BATTERY_S:
            self._asked = time.monotonic()
            self._link.write(bytes([protocol.BATTERY]))
        return len(found)

    def _emit(self, found: protocol.ShimmerPackets, feed: Feed) -> None:
        arrival = feed.now()
        raw = np.round(found.ticks * (NS / TICKS_HZ)).astype(np.int64)
        packets = self._stamps.take(len(found), arrival, raw)
        if hz := self._rate.see(len(found), 0, arrival, feed, raw):
            self._stamps.follow(hz)
        report_problems(feed, wrong_time=int((~packets.kept).sum()))
        if not len(packets.stamp):
            return
        report_losses(packets, feed, "lost packet", "device restarted")
        for output, values in (("motion", self._moved(found)), ("exg", self._measured(found))):
            if values is not None:
                for chunk in chunks(packets.stamp, packets.lost, values[packets.kept]):
                    feed.emit(chunk, output)
        feed.emit(timing_chunk(-1, packets.device, arrival, packets.stamp), "timing")

    def _moved(self, found: protocol.ShimmerPackets) -> Samples | None:
        if not self._motion:
            return None
        parts = [
            known.apply(protocol.columns(found, self._channels, list(MOTION[name][0])))
            for name, known in self._motion.items()
        ]
        return np.concatenate(parts, axis=1)

    def _measured(self, found: protocol.ShimmerPackets) -> Samples | None:
        return protocol.columns(found, self._channels, self._exg) * self._uv if self._exg else None

    def _report_battery(self, volts: float, feed: Feed) -> None:
        tell = log.warning if volts < LOW_BATTERY_V else log.info
        tell("battery", port=self._port, battery_v=round(volts, 2))
        if volts < LOW_BATTERY_V:
            feed.problem("low battery")
