"""A simulated BITalino (r)evolution on a walking person's leg, with a footswitch: its answers to commands, its frames."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from kinegraph.devices.bitalino import protocol as protocol
from kinegraph.devices.bitalino.protocol import GAINS, RATES_HZ, Sensor
from kinegraph.devices.people.treadmill.signal import Signal, Walker
from kinegraph.devices.simulation.sample_schedule import due
from kinegraph.devices.simulation.serve import Simulator, in_place
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.bitalino.source import Bitalino

MUSCLES = ("TA", "SO", "GM", "VM", "RF", "BF")
STEADY = {"eda": 5.0, "volt": 1.6}
"""What a sensor that is no amplifier shows, with a slow wave on it, in its unit."""


@dataclass(frozen=True, slots=True)
class SimulatedBitalino(Simulator):
    """A BITalino with muscles on its amplifiers."""

    port_name: ClassVar[str] = "rfcommSIM"

    sensors: tuple[Sensor, ...] = param(("emg",) * 6, help="what is plugged into A1 to A6")
    version: str = param("5.2", help="the firmware's")
    seed: int = param(0, least=0, help="another seed, another walk")

    def brain(self) -> BitalinoModel:
        return BitalinoModel(self.sensors, self.version, self.seed)


class BitalinoModel:
    """The device without Bluetooth. `counts` and `digital` give what frame `number` since the start holds."""

    def __init__(self, sensors: Sequence[Sensor] = ("emg",) * 6, version: str = "5.2", seed: int = 0) -> None:
        self._sensors, self._version = sensors, version
        self._signal = Signal(Walker(MUSCLES, seed=seed))
        self.rate_hz, self._inputs = 1000, list(range(6))
        self.battery_v = 3.9
        self._live = False
        self._began: float | None = None
        self._said = self._zero = 0

    def receive(self, data: bytes) -> bytes:
        return b"".join(self._obey(command) for command in data)

    def say(self, seconds: float) -> list[bytes]:
        if not self._live:
            return []
        if self._began is None:
            self._began = seconds
        first, self._said = due(self._said, seconds - self._began, self.rate_hz)
        return [self.frame(number) for number in range(first, self._said)]

    def restart(self) -> None:
        self._zero = self._said

    def frame(self, number: int) -> bytes:
        return protocol.frame(number - self._zero, self.counts(number), self.digital(number))

    def counts(self, number: int) -> list[int]:
        """The inputs that are sent, in ascending order."""
        index = round(number * 1000 / self.rate_hz)
        emg = self._signal.read(index, index + 1)[0][0]
        made = []
        for place, bits in zip(self._inputs, protocol.widths(len(self._inputs)), strict=True):
            scale, zero, _ = GAINS[self._sensors[place]]
            steady = STEADY.get(self._sensors[place])
            value = emg[place] if steady is None else steady * (1 + 0.2 * np.sin(index / 700 + place))
            made.append(int(np.clip(round((value / scale + zero) * (1 << bits)), 0, (1 << bits) - 1)))
        return made

    def digital(self, number: int) -> tuple[int, int, int, int]:
        """A footswitch on I1, and a button on I2 that is not pressed."""
        index = round(number * 1000 / self.rate_hz)
        return (int(self._signal.on_ground(np.array([index]))[0]), 1, 0, 0)

    def _obey(self, command: int) -> bytes:
        """One byte; returns the answer."""
        if self._live and command not in (0x00, 0xFF):
            return b""
        match command:
            case 0x00 | 0xFF:
                self._live = False
            case 0x07:
                return f"BITalino_v{self._version}\n".encode()
            case 0x0B:
                ports = self.digital(self._said)
                return protocol.state([512] * 6, self.battery_v, ports, f"BITalino_v{self._version}")
            case _ if command & 0x3F == 0x03:
                self.rate_hz = RATES_HZ[command >> 6]
            case _ if command & 0x03 == 0x01:
                self._inputs = [i for i in range(6) if command >> (2 + i) & 1]
                self._live, self._began, self._said, self._zero = bool(self._inputs), None, 0, 0
        return b""


def simulated(source: Bitalino) -> AbstractContextManager[Bitalino]:
    """What `--simulate` puts in its place."""
    plugged: dict[str, Sensor] = {channel.input: channel.sensor for channel in source.channels}
    return in_place(source, SimulatedBitalino(sensors=tuple(plugged.get(f"A{i}", "volt") for i in range(1, 7))))
