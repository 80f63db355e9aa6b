"""BITalino (r)evolution over Bluetooth's serial port, USB or TCP: one to six analogue inputs, and the digital ones."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import structlog

from kinegraph.devices.bitalino import protocol as protocol
from kinegraph.devices.bitalino.protocol import GAINS, BitalinoDecoder, BitalinoFrames, Sensor
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.short_counter import ShortCounter
from kinegraph.devices.clocks.stamps import chunks, report_losses, report_problems
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.transport.handshake import answer, quiet, shown, silence
from kinegraph.devices.transport.serial_source import SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

ANSWER_S = 3.0
PAUSE_S = 0.1
"""What the device needs between two commands."""
STATE_S = 1.0
SILENCE_S = 2.0
PORTS = ("I1", "I2", "O1", "O2")

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class BitalinoChannel:
    """An analogue input and what is plugged into it."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    input: Literal["A1", "A2", "A3", "A4", "A5", "A6"] = param(help="A1 to A6")
    sensor: Sensor = param("volt", help="emg, ecg or eeg (uV at the electrodes), eda (uS), or volt (V at the input)")
    name: str = param("", help="the channel's name; left out: the input's")


@dataclass(frozen=True, slots=True)
class Bitalino(SerialSource):
    """A BITalino (r)evolution that sends `channels` at `rate_hz`.

    analog    (channels,) float64, in each sensor's unit, by its data sheet
    digital   (4,) float64, 0 or 1: the ports I1 I2 O1 O2
    timing    an event per frame: counter, device time by the counter, arrival, stamp

    The first four inputs have 10 bits, a fifth and sixth 6 (in ascending order). The sequence number has 4 bits, so that at 1000 Hz it
    runs over every 16 ms. Less than that is known to be missing at once; whole turns show within a second (`devices.clocks.short_counter`).
    """

    outputs: ClassVar[tuple[str, ...]] = ("analog", "digital", "timing")

    port: str = param(
        help="/dev/rfcomm0, /dev/ttyUSB0, COM3 or tcp://host:port; `kinegraph devices` lists serial ports"
    )
    channels: tuple[BitalinoChannel, ...] = param(help="one to six inputs and their sensors")
    rate_hz: Literal[1, 10, 100, 1000] = param(1000, help="1, 10, 100 or 1000 frames per second")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the electrode to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz

    @property
    def ordered(self) -> list[BitalinoChannel]:
        """As they are sent: by input."""
        return sorted(self.channels, key=lambda channel: channel.input)

    def specs(self) -> Specs:
        inputs = [channel.input for channel in self.channels]
        names = tuple(channel.name or channel.input for channel in self.ordered)
        if not inputs or len(set(inputs)) != len(inputs) or len(set(names)) != len(names):
            raise ParameterError("channels", inputs, "one to six different inputs, with different names")
        device = {"device": "BITalino"}
        units = tuple(GAINS[channel.sensor][2] for channel in self.ordered)
        rate = float(self.rate_hz)
        return {
            "analog": StreamSpec((len(names),), rate_hz=rate, channels=names, units=units, meta=device),
            "digital": StreamSpec((4,), rate_hz=rate, channels=PORTS, meta=device),
            "timing": timing_spec(),
        }

    def greet(self, link: Transport, feed: Feed) -> BitalinoReading:
        link.write(protocol.STOP)
        quiet(link, feed, PAUSE_S, 2.0)
        link.write(protocol.VERSION)
        expected = "'BITalino_v...' and a line's end (is it switched on, and paired?)"
        text = answer(link, feed, until=b"\n", within_s=ANSWER_S, expected=expected)
        version = text[max(0, text.rfind(b"BITalino")) :].decode("ascii", "replace").strip()
        if not version.startswith("BITalino"):
            raise DeviceError(f"expected {expected} from {self.port}; came {shown(text)}")
        feed.wait(PAUSE_S)
        feed.identify("BITalino", port=self.port, firmware=version, **self._battery(link, feed, version))
        feed.wait(PAUSE_S)
        link.write(protocol.rate_command(self.rate_hz))
        feed.wait(PAUSE_S)
        link.write(protocol.start_command([int(channel.input[1]) for channel in self.ordered]))
        return BitalinoReading(self)

    def rest(self, link: Transport, feed: Feed) -> None:
        link.write(protocol.STOP)

    def _battery(self, link: Transport, feed: Feed, version: str) -> dict[str, float]:
        """The battery's voltage, from a device that tells it; those before (r)evolution do not."""
        link.write(protocol.STATE)
        size, came, deadline = protocol.state_size(version), b"", time.monotonic() + STATE_S
        while len(came) < size and time.monotonic() < deadline and not feed.stopped:
            came += link.read(STATE_S / 10)
        volts = protocol.battery_v(came, size)
        return {} if volts is None else {"battery_v": round(volts, 2)}


class BitalinoReading:
    """Frames to samples."""

    def __init__(self, of: Bitalino) -> None:
        self._port, self._size = of.port, protocol.size_of(len(of.channels))
        self._patience_s = SILENCE_S + 2 * protocol.AGREE / of.rate_hz
        self._decoder = BitalinoDecoder(len(of.channels))
        self._counter = ShortCounter(4, of.rate_hz, of.latency_s)
        parts = [GAINS[channel.sensor] for channel in of.ordered]
        self._scale, self._zero = np.array([p[0] for p in parts]), np.array([p[1] for p in parts])
        self._rate = RateCheck(of.port, float(of.rate_hz), of.rate_mismatch, counted=True)
        self._full = np.array([1 << bits for bits in protocol.widths(len(parts))], float)

    @property
    def clock(self) -> ClockState:
        return self._counter.state

    def wrong(self, silent_s: float, came: bytes) -> str:
        expected = f"{self._size} bytes with a right CRC"
        return silence("frame", self._port, silent_s, self._patience_s, expected, came)

    def take(self, data: bytes, feed: Feed) -> int:
        frames = self._decoder.feed(data)
        report_problems(feed, bytes_that_are_no_frame=frames.dropped, resync=frames.resyncs)
        if len(frames):
            self._emit(frames, feed)
        return len(frames)

    def _emit(self, frames: BitalinoFrames, feed: Feed) -> None:
        arrival = feed.now()
        packets = self._counter.take(frames.sequence, arrival)
        missing = report_losses(packets, feed, "lost frame", "counter reset")
        if hz := self._rate.see(len(packets.stamp), missing, arrival, feed):
            self._counter.follow(hz)
        analog = (frames.counts / self._full - self._zero) * self._scale
        digital = frames.digital.astype(np.float64)
        for first, second in zip(
            chunks(packets.stamp, packets.lost, analog), chunks(packets.stamp, packets.lost, digital), strict=True
        ):
            feed.emit(first, "analog")
            feed.emit(second, "digital")
        feed.emit(timing_chunk(packets.number, packets.device, arrival, packets.stamp), "timing")
