"""OpenBCI Cyton, with or without Daisy, through its USB dongle: 8 or 16 channels of EMG and the board's accelerometer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.packet_clock import PacketClock, Packets
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.stamps import chunks, report_losses, report_problems
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.cyton import protocol as protocol
from kinegraph.devices.cyton.protocol import PACKETS_HZ, ChannelSetting, CytonDecoder, CytonFrames
from kinegraph.devices.transport.handshake import answer, quiet, silence
from kinegraph.devices.transport.serial_source import SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.domain.impedance import Impedance
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

ACCEL_HZ = 25.0
SILENCE_S = 2.0
"""A board that was streaming and says nothing for so long is asked again."""
ANSWER_S = 5.0
ASIDE_S = 1.0
"""How long an answer may take that not every board gives."""
SENDING_S = 0.05
"""A board that sends has sent something within this."""
OPEN = 0.98
"""The part of a channel's range beyond which an electrode is not connected."""
DRIVEN_S, SETTLED_S = 1.0, 0.4
"""How long an electrode's impedance is measured, and how long it is waited for before."""
BOARD_RATE = "set the board's firmware back (command '~6')"


@dataclass(frozen=True, slots=True)
class Cyton(SerialSource):
    """An OpenBCI Cyton (8 channels at 250 Hz) or Cyton+Daisy (16 channels at 125 Hz) on the serial port of its dongle.

    emg      (8,) or (16,) float64, uV at the electrodes, by each channel's gain
    accel    (3,) float64, g, about 25 Hz: every new value of the board's accelerometer
    timing   an event per packet: counter, device time by the counter, arrival, stamp

    The board is reset, asked who it is, set to its defaults and to `settings`, and started. Lost packets are known from the counter.
    With a Daisy, even packets bring channels 9-16 and odd ones 1-8; a sample is an even one and the odd one after it (as BrainFlow pairs
    them), has the second one's stamp, and is lost if either is.

    Packets of `gather_s` are read at once, which delays them by as much at most and halves the work. Stamps come from the counter.

    The board measures its electrodes' impedances before a session (`kinegraph emg check-electrodes`): both poles of a channel, one after
    the other; with SRB2 on the positive or SRB1 on the negative side, the other pole alone.
    """

    outputs: ClassVar[tuple[str, ...]] = ("emg", "accel", "timing")

    port: str = param(help="the dongle's serial port, /dev/serial/by-id/NAME or COM3; `kinegraph devices` lists them")
    daisy: bool = param(False, help="16 channels at 125 Hz instead of 8 at 250 Hz")
    channels: tuple[str, ...] = param((), help="names of the 8 or 16 channels; left out: ch1, ch2, ...")
    settings: tuple[ChannelSetting, ...] = param(
        (), help="amplifier settings of channels that differ from the defaults"
    )
    gather_s: float = param(
        0.02,
        least=0,
        most=0.1,
        help="packets of this time are read at once; 0: each as it comes, for less delay and twice the work",
    )
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the electrode to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @property
    def chunk_s(self) -> float:
        return max(1 / self.rate_hz, self.gather_s)

    @property
    def gathered_s(self) -> float:
        return self.gather_s

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

    def greet(self, link: Transport, feed: Feed) -> CytonReading:
        self._set_up(link, feed)
        link.write(protocol.START)
        return CytonReading(self)

    def rest(self, link: Transport, feed: Feed) -> None:
        link.write(protocol.STOP)

    def impedances(self, feed: Feed) -> Iterator[Impedance]:
        names, given = self.specs()["emg"].channels, {setting.channel: setting for setting in self.settings}
        with self.connect() as link:
            self._set_up(link, feed)
            for number, name in enumerate(names, 1):
                setting = given.get(number, ChannelSetting(number))
                if not setting.power or setting.input != "normal":
                    continue
                for pole, free in (("+", not setting.srb2), ("-", not setting.srb1)):
                    if free:
                        yield Impedance(name, pole, self._impedance(link, feed, setting, pole), protocol.DRIVE_HZ)

    def _impedance(self, link: Transport, feed: Feed, setting: ChannelSetting, pole: str) -> float:
        """Ohm of one electrode; infinite where the channel stands at the end of its range."""
        self._ask(link, feed, protocol.lead_off(setting.channel, pole == "+", pole == "-"))
        link.write(protocol.START)
        try:
            number, counts = self._driven(link, feed, setting.channel)
        finally:
            link.write(protocol.STOP)
            quiet(link, feed, SENDING_S, 1.0)
        self._ask(link, feed, protocol.lead_off(setting.channel, False, False))
        if np.abs(counts).max() > OPEN * protocol.FULL_SCALE:
            return float("inf")
        return protocol.impedance_ohm(number, counts * protocol.uv_per_count(setting.gain), self.daisy)

    def _driven(self, link: Transport, feed: Feed, channel: int) -> tuple[Times, Samples]:
        """Running numbers and counts of one channel's samples, while the current is driven."""
        decoder, counters, counts = CytonDecoder(), list[Times](), list[Samples]()
        wanted, deadline = (
            round((SETTLED_S + DRIVEN_S) * PACKETS_HZ),
            time.monotonic() + SETTLED_S + DRIVEN_S + SILENCE_S,
        )
        while sum(map(len, counters)) < wanted:
            if feed.stopped or time.monotonic() > deadline:
                raise DeviceError(
                    f"{sum(map(len, counters))} of {wanted} packets while impedance was measured, on {self.port}"
                )
            frames = decoder.feed(link.read(ASIDE_S / 10))
            counters.append(frames.counter.astype(np.int64))
            counts.append(frames.counts[:, (channel - 1) % protocol.CHANNELS])
        counter = np.concatenate(counters)
        number = np.cumsum(np.diff(counter, prepend=counter[0]) % 256)
        first = number >= number[-1] - DRIVEN_S * PACKETS_HZ
        if self.daisy:
            first &= (counter % 2 == 0) == (channel > protocol.CHANNELS)
        return number[first], np.concatenate(counts)[first]

    def _set_up(self, link: Transport, feed: Feed) -> None:
        if link.read(SENDING_S):  # it was left running
            link.write(protocol.STOP)
            quiet(link, feed, SENDING_S, 1.0)
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
        self._restore_defaults(link, feed)
        for setting in self.settings:
            self._ask(link, feed, setting.command)

    def _restore_defaults(self, link: Transport, feed: Feed) -> None:
        """The reset has set them already: an emulator that knows no such command is read as it is."""
        link.write(protocol.DEFAULTS)
        try:
            text = answer(link, feed, until=protocol.ENDING, within_s=ASIDE_S, expected="")
        except DeviceError:
            if feed.stopped:
                raise
            feed.problem("no answer to 'd'")
            return
        self._check_obeyed(protocol.DEFAULTS, text)

    def _ask(self, link: Transport, feed: Feed, command: bytes) -> None:
        """Send a command; raises DeviceError unless the board says that it was done."""
        link.write(command)
        expected = f"an answer to {command.decode()!r} ending in '$$$'"
        text = answer(link, feed, until=protocol.ENDING, within_s=ANSWER_S, expected=expected)
        self._check_obeyed(command, text)

    @staticmethod
    def _check_obeyed(command: bytes, text: bytes) -> None:
        if b"Failure" in text:
            raise DeviceError(f"the board refused {command.decode()!r}: {text.decode('ascii', 'replace').strip()}")


class CytonReading:
    """Packets to samples."""

    def __init__(self, of: Cyton) -> None:
        self._port = of.port
        self._decoder, self._clock = CytonDecoder(), PacketClock(8, PACKETS_HZ, of.latency_s)
        self._rate = RateCheck(of.port, PACKETS_HZ, of.rate_mismatch, setting=BOARD_RATE, counted=True)
        self._daisy = of.daisy
        gains = {setting.channel: setting.gain for setting in of.settings}
        self._uv = np.array([protocol.uv_per_count(gains.get(i + 1, 24)) for i in range(16 if of.daisy else 8)])
        self._half: tuple[int, Samples] | None = None
        """A Daisy's even packet that waits for its odd one: number, counts (1, 8)."""
        self._sample: int | None = None
        self._accelerated = 0
        self._unknown = False

    @property
    def clock(self) -> ClockState:
        return self._clock.state

    def wrong(self, silent_s: float, came: bytes) -> str:
        return silence("packet", self._port, silent_s, SILENCE_S, "33 bytes from A0 to C0", came)

    def take(self, data: bytes, feed: Feed) -> int:
        frames = self._decoder.feed(data)
        if len(frames):
            self._emit(frames, feed)
        if frames.dropped or frames.resyncs:
            report_problems(feed, bytes_that_are_no_packet=frames.dropped, resync=frames.resyncs)
        return len(frames)

    def _emit(self, frames: CytonFrames, feed: Feed) -> None:
        arrival = feed.now()
        one = len(frames) == 1
        packets = self._clock.take_one(frames.newest, arrival) if one else self._clock.take(frames.counter, arrival)
        n = len(packets.number)
        repeated = len(frames) - n
        if repeated:
            feed.problem("repeated packet", repeated)
        if not n:
            return
        missing = 0 if packets.clean else report_losses(packets, feed, "lost packet", "counter reset")
        if hz := self._rate.see(n, missing, arrival, feed):
            self._clock.follow(hz)
        self._emg(packets, frames.counts[packets.kept] if repeated else frames.counts, feed)
        if frames.moved:
            self._accel(frames, packets, feed)
        if not packets.clean and (packets.lost < 0).any():
            missing = -1
        feed.emit(timing_chunk(packets.number, packets.device, arrival, packets.stamp, missing), "timing")

    def _emg(self, packets: Packets, counts: Samples, feed: Feed) -> None:
        stamp, lost = packets.stamp, packets.lost
        if self._daisy:
            stamp, lost, counts = self._samples(packets, counts)
        for chunk in chunks(stamp, lost, counts * self._uv):
            feed.emit(chunk, "emg")

    def _samples(self, packets: Packets, counts: Samples) -> tuple[Times, Times, Samples]:
        """A Daisy's samples (stamp, lost, counts (k, 16)); a counter that started again makes the next one's loss unknown."""
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


def _identity(text: str) -> dict[str, str]:
    """What the greeting says about the board: its firmware, and the rest on one line. It has no serial number."""
    lines = [line.strip() for line in text.removesuffix("$$$").splitlines() if line.strip()]
    firmware = [line.partition(":")[2].strip() for line in lines if line.startswith("Firmware")]
    return {"firmware": firmware[0] if firmware else "", "greeting": "; ".join(lines)}
