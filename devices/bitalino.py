"""BITalino (r)evolution over Bluetooth's serial port, USB or TCP: one to six analogue inputs, and the digital ones."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
import structlog

from devices.clocks.clock_log import ClockLog
from devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from devices.clocks.short_counter import ShortCounter
from devices.clocks.stamps import runs
from devices.clocks.timing import timing_chunk, timing_spec
from devices.protocols import bitalino as protocol
from devices.protocols.bitalino import GAINS, BitalinoDecoder, BitalinoFrames, Sensor
from devices.transport.handshake import all_there, answer, quiet, shown
from devices.transport.transport import Transport, connect, present
from stream.chunk import Chunk, Specs, StreamSpec
from stream.errors import DeviceError, ParameterError
from stream.params import param
from stream.source import Feed, Source

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
class Bitalino(Source):
    """A BITalino (r)evolution, which is told to send `channels` at `rate_hz`.

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

    @contextmanager
    def simulated(self) -> Iterator[Source]:
        from devices.simulators.bitalino import SimulatedBitalino as Simulated

        with Simulated(sensors=tuple(channel.sensor for channel in self._all_inputs())).serving() as address:
            yield replace(self, port=address)

    def _all_inputs(self) -> list[BitalinoChannel]:
        known = {channel.input: channel for channel in self.channels}
        return [known.get(name, BitalinoChannel(name)) for name in ("A1", "A2", "A3", "A4", "A5", "A6")]

    def present(self) -> bool | None:
        return present(self.port)

    def read(self, feed: Feed) -> None:
        with connect(self.port) as link:
            self._greet(link, feed)
            try:
                self._stream(link, feed)
            finally:
                with suppress(DeviceError):
                    link.write(protocol.STOP)

    def _greet(self, link: Transport, feed: Feed) -> None:
        """Bring the device to rest and ask who it is; raises DeviceError if it is not there."""
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

    def _battery(self, link: Transport, feed: Feed, version: str) -> dict[str, float]:
        """The battery's voltage, from a device that tells it; those before (r)evolution do not."""
        link.write(protocol.STATE)
        size, came, deadline = protocol.state_size(version), b"", time.monotonic() + STATE_S
        while len(came) < size and time.monotonic() < deadline and not feed.stopped:
            came += link.read(STATE_S / 10)
        volts = protocol.battery_v(came, size)
        return {} if volts is None else {"battery_v": round(volts, 2)}

    def _stream(self, link: Transport, feed: Feed) -> None:
        decoder, stream = BitalinoDecoder(len(self.channels)), _Stream(self)
        patience = SILENCE_S + 2 * protocol.AGREE / self.rate_hz
        heard, clock_log = time.monotonic(), ClockLog(self.port, feed, lambda: stream.counter.state)
        strange = b""
        while not feed.stopped:
            data = link.read(0.1)
            now = time.monotonic()
            if data and now - heard > 0.1:
                data = all_there(link, data)
            frames = decoder.feed(data)
            if frames.dropped:
                feed.problem("bytes that are no frame", frames.dropped)
            if frames.resyncs:
                feed.problem("resync", frames.resyncs)
            if len(frames):
                stream.pass_on(frames, feed)
                heard, strange = now, b""
            else:
                strange = (strange + data)[:64]
            if now - heard > patience:
                size = protocol.size_of(len(self.channels))
                raise DeviceError(
                    f"no frame from {self.port} for {patience:g} s: expected {size} bytes with a right CRC; came {shown(strange)}"
                )
            clock_log.tell()


class _Stream:
    """Frames to samples: what is remembered between two reads."""

    def __init__(self, of: Bitalino) -> None:
        self.counter = ShortCounter(4, of.rate_hz, of.latency_s)
        parts = [GAINS[channel.sensor] for channel in of.ordered]
        self._scale, self._zero = np.array([p[0] for p in parts]), np.array([p[1] for p in parts])
        self._rate = RateCheck(of.port, float(of.rate_hz), of.rate_mismatch, counted=True)
        self._full = np.array([1 << bits for bits in protocol.widths(len(parts))], float)

    def pass_on(self, frames: BitalinoFrames, feed: Feed) -> None:
        """Emit what a read has brought."""
        arrival = feed.now()
        packets = self.counter.take(frames.sequence, arrival)
        if missing := int(packets.lost.sum()):
            feed.problem("lost frame", missing)
        if hz := self._rate.see(len(packets.stamp), missing, arrival, feed):
            self.counter.follow(hz)
        analog = (frames.counts / self._full - self._zero) * self._scale
        digital = frames.digital.astype(np.float64)
        for start, stop in runs(packets.lost):
            times, lost = packets.stamp[start:stop], int(packets.lost[start])
            feed.emit(Chunk(times, analog[start:stop], int(times[-1]), lost), "analog")
            feed.emit(Chunk(times, digital[start:stop], int(times[-1]), lost), "digital")
        feed.emit(timing_chunk(packets.number, packets.device, arrival, packets.stamp), "timing")
