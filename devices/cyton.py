"""OpenBCI Cyton, with or without Daisy, through its USB dongle: 8 or 16 channels of EMG and the board's accelerometer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from devices.clocks.clock_log import ClockLog
from devices.clocks.packet_clock import PacketClock, Packets
from devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from devices.clocks.stamps import runs
from devices.clocks.timing import timing_chunk, timing_spec
from devices.protocols import cyton as protocol
from devices.protocols.cyton import ChannelSetting, CytonDecoder, CytonFrames
from devices.transport.handshake import all_there, answer, quiet, shown
from devices.transport.transport import Transport, connect, present
from stream.chunk import NS, Chunk, Samples, Specs, StreamSpec, Times
from stream.errors import DeviceError, ParameterError
from stream.params import param
from stream.source import Feed, Source

PACKETS_HZ = 250.0
ACCEL_HZ = 25.0
SILENCE_S = 2.0
"""A board that was streaming and says nothing for so long is asked anew."""
ANSWER_S = 5.0
BOARD_RATE = "set the board's firmware back (command '~6')"


@dataclass(frozen=True, slots=True)
class Cyton(Source):
    """An OpenBCI Cyton (8 channels at 250 Hz) or Cyton+Daisy (16 channels at 125 Hz) on the serial port of its dongle.

    emg      (8,) or (16,) float64, uV at the electrodes, by each channel's gain
    accel    (3,) float64, g, about 25 Hz: every new value of the board's accelerometer
    timing   an event per packet: counter, device time by the counter, arrival, stamp

    The board is reset, asked who it is, set to its defaults and to `settings`, and told to begin. Lost packets are known from the counter.
    With a Daisy, even packets bring channels 9-16 and odd ones 1-8; a sample is an even one and the odd one after it (as BrainFlow pairs
    them), has the second one's stamp, and is lost if either is.
    """

    outputs: ClassVar[tuple[str, ...]] = ("emg", "accel", "timing")

    port: str = param(help="the dongle's serial port, /dev/serial/by-id/NAME or COM3; `kinegraph devices` lists them")
    daisy: bool = param(False, help="16 channels at 125 Hz instead of 8 at 250 Hz")
    channels: tuple[str, ...] = param((), help="names of the 8 or 16 channels; left out: ch1, ch2, ...")
    settings: tuple[ChannelSetting, ...] = param(
        (), help="amplifier settings of channels that differ from the defaults"
    )
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the electrode to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return PACKETS_HZ / 2 if self.daisy else PACKETS_HZ

    def specs(self) -> Specs:
        n = 16 if self.daisy else 8
        names = self.channels or tuple(f"ch{i + 1}" for i in range(n))
        if len(names) != n or len(set(names)) != n:
            accepts = f"{n} different names{'' if self.daisy else ' (16 with `daisy: true`)'}, or left out"
            raise ParameterError("channels", list(names), accepts)
        numbers = [setting.channel for setting in self.settings]
        if any(number > n for number in numbers) or len(set(numbers)) != len(numbers):
            raise ParameterError("settings", numbers, f"channels 1 to {n}, each at most once")
        device = {"device": "OpenBCI Cyton+Daisy" if self.daisy else "OpenBCI Cyton"}
        return {
            "emg": StreamSpec((n,), rate_hz=self.rate_hz, channels=names, units=("uV",), meta=device),
            "accel": StreamSpec((3,), rate_hz=ACCEL_HZ, channels=("x", "y", "z"), units=("g",), meta=device),
            "timing": timing_spec(),
        }

    @contextmanager
    def simulated(self) -> Iterator[Source]:
        from devices.simulators.cyton import SimulatedCyton as Simulated

        with Simulated(daisy=self.daisy).serving() as address:
            yield replace(self, port=address)

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
        """Bring the board to a known state; raises DeviceError if it is not there, or not this one."""
        link.write(protocol.STOP)
        quiet(link, feed, 0.05, 1.0)
        link.write(protocol.SOFT_RESET)
        text = answer(
            link,
            feed,
            until=protocol.ENDING,
            within_s=ANSWER_S,
            expected="the board's greeting ending in '$$$' (is the board switched to PC, and does the dongle's switch stand at GPIO6?)",
        ).decode("ascii", "replace")
        if "Failure" in text or "OpenBCI" not in text:
            raise DeviceError(
                f"expected a greeting that names OpenBCI; came {text.strip()!r}. A dongle alone answers 'Failure': is the board on?"
            )
        has_daisy = "Daisy" in text
        if self.daisy and not has_daisy:
            raise DeviceError(f"no Daisy is attached to the board on {self.port}; put it on, or set `daisy: false`")
        feed.identify("OpenBCI Cyton+Daisy" if has_daisy else "OpenBCI Cyton", port=self.port, **_identity(text))
        if has_daisy:
            self._ask(link, feed, protocol.WITH_DAISY if self.daisy else protocol.ONLY_BOARD)
        self._ask(link, feed, protocol.DEFAULTS)
        for setting in self.settings:
            self._ask(link, feed, setting.command)

    def _ask(self, link: Transport, feed: Feed, command: bytes) -> None:
        """Send a command; raises DeviceError unless the board says that it was done."""
        link.write(command)
        expected = f"an answer to {command.decode()!r} ending in '$$$'"
        text = answer(link, feed, until=protocol.ENDING, within_s=ANSWER_S, expected=expected)
        if b"Failure" in text:
            raise DeviceError(f"the board refused {command.decode()!r}: {text.decode('ascii', 'replace').strip()}")

    def _stream(self, link: Transport, feed: Feed) -> None:
        decoder, stream = CytonDecoder(), _Stream(self)
        link.write(protocol.START)
        heard, clock_log = time.monotonic(), ClockLog(self.port, feed, lambda: stream.clock.state)
        strange = b""
        while not feed.stopped:
            data = link.read(0.1)
            now = time.monotonic()
            if data and now - heard > 0.1:
                data = all_there(link, data)
            frames = decoder.feed(data)
            if len(frames):
                stream.pass_on(frames, feed)
                heard, strange = now, b""
            else:
                strange = (strange + data)[:64]
            _count(frames, feed)
            if now - heard > SILENCE_S:
                raise DeviceError(
                    f"no packet from {self.port} for {SILENCE_S:g} s: expected 33 bytes from A0 to C0; came {shown(strange)}"
                )
            clock_log.tell()


class _Stream:
    """Packets to samples: what is remembered between two reads."""

    def __init__(self, of: Cyton) -> None:
        self.clock = PacketClock(8, PACKETS_HZ, of.latency_s)
        self._rate = RateCheck(of.port, PACKETS_HZ, of.rate_mismatch, setting=BOARD_RATE, counted=True)
        self._daisy = of.daisy
        gains = {setting.channel: setting.gain for setting in of.settings}
        self._uv = np.array([protocol.uv_per_count(gains.get(i + 1, 24)) for i in range(16 if of.daisy else 8)])
        self._half: tuple[int, Samples] | None = None
        """A Daisy's even packet that waits for its odd one: number, counts (1, 8)."""
        self._sample: int | None = None
        self._accelerated = 0
        self._unknown = False

    def pass_on(self, frames: CytonFrames, feed: Feed) -> None:
        """Emit what a read has brought."""
        arrival = feed.now()
        packets = self.clock.take(frames.counter, arrival)
        repeated = len(frames) - len(packets.number)
        if repeated:
            feed.problem("repeated packet", repeated)
        if not len(packets.number):
            return
        gaps = bool(packets.lost.any())
        missing = int(packets.lost.clip(0).sum()) if gaps else 0
        if hz := self._rate.see(len(packets.number), missing, arrival, feed):
            self.clock.follow(hz)
        if gaps:
            self._tell_gaps(packets, feed)
        self._emg(packets, frames.counts[packets.kept] if repeated else frames.counts, gaps, feed)
        self._accel(frames, packets, feed)
        missing = _all_lost(packets.lost) if gaps else 0
        feed.emit(timing_chunk(packets.number, packets.device, arrival, packets.stamp, missing), "timing")

    def _tell_gaps(self, packets: Packets, feed: Feed) -> None:
        missing = int(packets.lost.clip(0).sum())
        if missing:
            feed.problem("lost packet", missing)
        if (packets.lost < 0).any():
            feed.problem("counter reset")

    def _emg(self, packets: Packets, counts: Samples, gaps: bool, feed: Feed) -> None:
        stamp, lost = packets.stamp, packets.lost
        if self._daisy:
            stamp, lost, counts = self._samples(packets, counts)
        if not self._daisy and not gaps:
            feed.emit(Chunk(stamp, counts * self._uv, int(stamp[-1])), "emg")
            return
        for start, stop in runs(lost):
            times = stamp[start:stop]
            feed.emit(Chunk(times, counts[start:stop] * self._uv, int(times[-1]), int(lost[start])), "emg")

    def _samples(self, packets: Packets, counts: Samples) -> tuple[Times, Times, Samples]:
        """A Daisy's samples (stamp, lost, counts (k, 16)); a counter that began anew makes the next one's loss unknown."""
        self._unknown |= bool((packets.lost < 0).any())
        number, stamp, counts = self._pairs(packets, counts)
        if not len(number):
            return stamp, number, counts
        before = number[0] - 1 if self._sample is None else self._sample
        lost = np.diff(number, prepend=before) - 1
        self._sample = int(number[-1])
        if self._unknown:
            lost[0], self._unknown = -1, False
        return stamp, lost, counts

    def _pairs(self, packets: Packets, counts: Samples) -> tuple[Times, Times, Samples]:
        """The samples (number, stamp, counts (k, 16)) of even packets directly followed by odd ones."""
        number, stamp = packets.number, packets.stamp
        if self._half:
            number, stamp = np.insert(number, 0, self._half[0]), np.insert(stamp, 0, 0)
            counts = np.concatenate([self._half[1], counts])
        even = np.flatnonzero((number[:-1] % 2 == 0) & (np.diff(number) == 1))
        self._half = (int(number[-1]), counts[-1:]) if number[-1] % 2 == 0 else None
        return number[even] // 2, stamp[even + 1], np.hstack([counts[even + 1], counts[even]])

    def _accel(self, frames: CytonFrames, packets: Packets, feed: Feed) -> None:
        index, values = protocol.acceleration(frames)
        if not len(index):
            return
        new = packets.kept[index]
        place = (np.cumsum(packets.kept) - 1)[index[new]]
        values, stamp = values[new], packets.stamp[place]
        for i in range(len(stamp)):
            period = (int(stamp[i]) - self._accelerated) * ACCEL_HZ / NS if self._accelerated else 1.0
            self._accelerated = int(stamp[i])
            lost = max(0, round(period) - 1) if period > 1.75 else 0
            feed.emit(Chunk(stamp[i : i + 1], values[i : i + 1], int(stamp[i]), lost), "accel")


def _all_lost(lost: Times) -> int:
    return -1 if (lost < 0).any() else int(lost.sum())


def _count(frames: CytonFrames, feed: Feed) -> None:
    if frames.dropped:
        feed.problem("bytes that are no packet", frames.dropped)
    if frames.resyncs:
        feed.problem("resync", frames.resyncs)


def _identity(text: str) -> dict[str, str]:
    """What the greeting tells of the board: its firmware, and the rest on one line. It has no serial number."""
    lines = [line.strip() for line in text.removesuffix("$$$").splitlines() if line.strip()]
    firmware = [line.partition(":")[2].strip() for line in lines if line.startswith("Firmware")]
    return {"firmware": firmware[0] if firmware else "", "greeting": "; ".join(lines)}
