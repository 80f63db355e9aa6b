"""A simulated OpenBCI Cyton, with or without Daisy: its answers, its packets, and the EMG of someone walking on a treadmill."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from kinegraph.devices.cyton import protocol as protocol
from kinegraph.devices.cyton.protocol import (
    CHANNELS,
    DRIVE_A,
    DRIVE_HZ,
    GAINS,
    PACKETS_HZ,
    SERIES_OHM,
    packet,
    uv_per_count,
)
from kinegraph.devices.people.treadmill.signal import BURSTS, Signal, Walker
from kinegraph.devices.simulation.serve import Simulator, in_place
from kinegraph.devices.simulation.shared_walk import WALK
from kinegraph.stream.chunk import Samples
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.cyton.source import Cyton

ACCEL_EVERY = 10
OPEN_OHM = 1e12
"""An electrode that is not there."""
MAX_BEHIND = 2500
"""Packets that are made at once at most; what is older by then is left out and lost."""


@dataclass(frozen=True, slots=True)
class SimulatedCyton(Simulator):
    """A Cyton on a leg: the treadmill walker's muscles on its channels, its swinging shank on the accelerometer."""

    port_name: ClassVar[str] = "ttyCYTON"

    daisy: bool = param(False, help="with a Daisy: 16 channels at 125 Hz")
    firmware: str = param("v3.1.2", help="what the greeting says")
    seed: int = param(0, least=0, help="another seed, another walk")

    impedances_kohm: tuple[float, ...] = param(
        (), least=0.0, help="of the electrodes: channel 1's +, its -, channel 2's + ...; those not given have 5 to 14"
    )

    def brain(self) -> CytonModel:
        return CytonModel(self.daisy, self.firmware, self.seed, self.impedances_kohm)


class CytonModel:
    """The board and its dongle, without a cable.

    The signal is a function of a packet's running number alone; `counts` tells it, so that what a reader makes of it can be checked.
    """

    def __init__(
        self, daisy: bool = False, firmware: str = "v3.1.2", seed: int = 0, impedances_kohm: tuple[float, ...] = ()
    ) -> None:
        poles = 5.0 + 7 * np.arange(4 * CHANNELS) % 10
        poles[: len(impedances_kohm)] = impedances_kohm[: len(poles)]
        self.ohm = 1000 * poles.reshape(2 * CHANNELS, 2)
        self._has_daisy, self._firmware = daisy, firmware
        muscles = tuple(list(BURSTS) + list(BURSTS)[: 2 * CHANNELS - len(BURSTS)])
        self._signal = Signal(Walker(muscles, rate_hz=PACKETS_HZ, seed=seed))
        self._reset()
        self._said = 0
        self._began: float | None = None
        self._ahead = 0
        """At which sample of the walk packet 0 lies."""
        self._number = 0
        self._zero = 0
        self._pending = b""
        self._streaming = False

    def receive(self, data: bytes) -> bytes:
        answers = b""
        data, self._pending = self._pending + data, b""
        while data:
            if data[:1] in (b"x", b"z"):
                end = data.find(data[:1].upper())
                if end < 0 and len(data) < (9 if data[:1] == b"x" else 5):
                    self._pending = data
                    break
                command, data = data[: end + 1], data[end + 1 or len(data) :]
                answers += self._set_channel(command) if command[:1] == b"x" else self._set_lead_off(command)
            else:
                answers += self._obey(data[:1].decode("latin-1"))
                data = data[1:]
        return answers

    def say(self, seconds: float) -> list[bytes]:
        if not self._streaming:
            return []
        if self._began is None:
            self._began, self._ahead = seconds, WALK.samples(PACKETS_HZ)
        due = int((seconds - self._began) * PACKETS_HZ)
        first = max(self._said, due - MAX_BEHIND)
        self._number += first - self._said
        packets = []
        for _ in range(first, due):
            packets.append(self._packet(self._number))
            self._number += 1
        self._said = max(self._said, due)
        return packets

    def restart(self) -> None:
        self._zero = self._number

    def counts(self, number: int) -> Samples:
        """What the packet with this running number holds (8,): a whole number of counts per channel."""
        start, walked = max(0, number - 1), self._ahead + number
        emg = (
            self._signal.read(self._ahead + start, walked + 1)[0].mean(axis=0)
            if self._sixteen
            else self._signal.read(walked, walked + 1)[0][0]
        )
        emg = emg + (0.5 * (self._drive(start) + self._drive(number)) if self._sixteen else self._drive(number))
        first = CHANNELS if self._sixteen and self._counter(number) % 2 == 0 else 0
        channels = slice(first, first + CHANNELS)
        counts = np.round(emg[channels] / self._uv[channels]) * self._power[channels]
        return np.asarray(np.clip(counts, -(2**23), 2**23 - 1))

    def _drive(self, number: int) -> Samples:
        """What the current for measuring impedance does to each channel (16,), uV."""
        if not self._driven.any():
            return np.zeros(2 * CHANNELS)
        wave = DRIVE_A * np.sin(2 * np.pi * DRIVE_HZ / PACKETS_HZ * number + 0.3)
        volts = np.where(self._driven, (np.minimum(self.ohm, OPEN_OHM) + SERIES_OHM) * wave, 0.0)
        return np.asarray(1e6 * (volts[:, 0] - volts[:, 1]))

    def acceleration(self, number: int) -> Samples:
        """What the accelerometer says with this packet (3,), g: gravity and a leg that swings."""
        turn = 2 * np.pi * float(self._signal.phase(np.array([self._ahead + number]))[0])
        return np.array([0.35 * np.sin(turn), 0.08 * np.sin(2 * turn), 1.0 + 0.25 * np.cos(2 * turn)])

    def _packet(self, number: int) -> bytes:
        aux = bytes(6)
        if number % ACCEL_EVERY == 0:
            aux = np.round(self.acceleration(number) / protocol.G_PER_COUNT).astype(">i2").tobytes()
        return packet(self._counter(number), self.counts(number), aux)

    def _counter(self, number: int) -> int:
        return (number - self._zero) % 256

    def _reset(self) -> None:
        self._sixteen = self._has_daisy
        self._uv = np.full(2 * CHANNELS, uv_per_count(24))
        self._power = np.ones(2 * CHANNELS)
        self._driven = np.zeros((2 * CHANNELS, 2), bool)

    def _obey(self, command: str) -> bytes:
        """One letter; returns the answer."""
        match command:
            case "v":
                self._streaming = False
                self._reset()
                return self._greeting()
            case "b":
                self._streaming, self._began, self._said = True, None, 0
                self._zero = self._number
            case "s":
                self._streaming = False
            case "d":
                self._reset()
                return b"updating channel settings to default$$$"
            case "c":
                self._sixteen = False
                return b"daisy removed$$$" if self._has_daisy else b"8$$$"
            case "C":
                self._sixteen = self._has_daisy
                return b"16$$$" if self._has_daisy else b"no daisy to attach!8$$$"
            case "V":
                return f"{self._firmware}$$$".encode()
            case _:
                self._switch(command)
        return b""

    def _switch(self, command: str) -> None:
        for channel in range(1, 2 * CHANNELS + 1):
            for on in (True, False):
                if protocol.switch(channel, on) == command.encode("latin-1"):
                    self._power[channel - 1] = on

    def _set_channel(self, command: bytes) -> bytes:
        names = b"12345678QWERTYUI"
        if len(command) != 9 or command[1] not in names or not command[2:8].isdigit() or command[3] - 48 >= len(GAINS):
            return b"Failure: too few chars$$$" if len(command) < 9 else b"Failure: invalid channel settings$$$"
        channel = names.index(command[1])
        self._power[channel] = float(command[2] == ord("0"))
        self._uv[channel] = uv_per_count(GAINS[command[3] - 48])
        return f"Success: Channel set for {channel + 1}$$$".encode()

    def _set_lead_off(self, command: bytes) -> bytes:
        names = b"12345678QWERTYUI"
        if len(command) != 5 or command[1] not in names or not set(command[2:4]) <= set(b"01"):
            answer = b"Failure: too few chars$$$" if len(command) < 5 else b"Failure: Err: too many chars$$$"
            return b"" if self._streaming else answer
        channel = names.index(command[1])
        self._driven[channel] = command[2] == ord("1"), command[3] == ord("1")
        return b"" if self._streaming else f"Success: Lead off set for {channel + 1}$$$".encode()

    def _greeting(self) -> bytes:
        lines = ["OpenBCI V3 8-16 channel", "On Board ADS1299 Device ID: 0x3E"]
        lines += ["On Daisy ADS1299 Device ID: 0x3E"] if self._has_daisy else []
        lines += ["LIS3DH Device ID: 0x33", f"Firmware: {self._firmware}", "$$$"]
        return "\r\n".join(lines).encode()


def simulated(source: Cyton) -> AbstractContextManager[Cyton]:
    """What `--simulate` puts in its place."""
    return in_place(source, SimulatedCyton(daisy=source.daisy))
