"""A simulated Shimmer3 with LogAndStream on a walking person's right shank: its answers to commands, its packets."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from kinegraph.devices.people.treadmill.signal import Signal, Walker
from kinegraph.devices.people.walking_back import Back
from kinegraph.devices.people.walking_limb import Limb, Site
from kinegraph.devices.shimmer import protocol as protocol
from kinegraph.devices.shimmer import units as units
from kinegraph.devices.shimmer.protocol import ACK, IN_STREAM, TICKS_HZ
from kinegraph.devices.shimmer.units import ShimmerCalibration
from kinegraph.devices.simulation.sample_schedule import due
from kinegraph.devices.simulation.serve import Simulator, in_place
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.shimmer.source import Shimmer

MEASURED = ("acceleration", "angular_velocity", "wide_acceleration")
MUSCLES = ("TA", "GM", "SO", "PL")
LENGTHS = {0x05: 3, 0x08: 4, 0x09: 2, 0x40: 2, 0x49: 2, 0x4C: 2, 0x63: 4, 0x66: 3, 0xA3: 2}
"""Bytes of the commands that have any behind the first."""
OUTPUTS = {"acceleration": (0, 1, 2), "wide_acceleration": (4, 5, 6), "angular_velocity": (10, 11, 12),
           "exg1": (29, 30, 31), "exg2": (32, 33, 34)}  # fmt: skip
FACTORY_TICKS = 640
BOARD = (47, 5, 0)
"""An ExG unit of the later boards."""
LONELY = 101
"""A walker whom the shipped model of walking manners was not trained on, as of `devices.mti.back_walker`."""


@dataclass(frozen=True, slots=True)
class SimulatedShimmer(Simulator):
    """A Shimmer3 with EMG electrodes on a shank, or one at the lower back of somebody who walks, turns and stands."""

    port_name: ClassVar[str] = "rfcommSHIM"

    site: Site | Literal["lower_back"] = param("shank", help="where it is worn: foot, shank or lower_back")
    firmware: tuple[int, int, int] = param((0, 16, 0), help="LogAndStream's version")
    board: tuple[int, int, int] = param(
        BOARD,
        help="the expansion board's number, revision and special revision; before SR47-3-0 it has older accelerometers",
    )
    seed: int = param(0, least=0, help="another seed, another walk")

    def brain(self) -> ShimmerModel:
        return ShimmerModel(self.site, self.firmware, self.seed, self.board)


class ShimmerModel:
    """The sensor without Bluetooth. Packet i since START holds sample i of its signals; `counts` tells what."""

    def __init__(
        self,
        site: Site | Literal["lower_back"] = "shank",
        firmware: tuple[int, int, int] = (0, 16, 0),
        seed: int = 0,
        board: tuple[int, int, int] = BOARD,
    ) -> None:
        self._site, self._firmware, self._seed = site, firmware, seed
        self._board = bytes(board)
        self.chips = units.chips_of(self._board)
        self._emg = Signal(Walker(MUSCLES, seed=seed))
        self.divider = FACTORY_TICKS
        self.channels: tuple[int, ...] = OUTPUTS["acceleration"]
        self.wide_range, self.gyro_range = 0, 1
        self.wide_hz, self.gyro_hz = 100.0, units.GYRO_HZ / 156
        """How often the digital sensors themselves measure; from the factory, slower than most packets."""
        self.registers = list(units.registers("emg", TICKS_HZ / FACTORY_TICKS))
        self.calibrated = {
            name: ShimmerCalibration(
                known.offset + 3, known.sensitivity * np.array([1.01, 0.99, 1.02]), known.alignment
            )
            for name in MEASURED
            if (known := units.nominal(name, chips=self.chips))
        }
        self.battery_v = 3.95
        self._pending = b""
        self._streaming = False
        self._began: float | None = None
        self._said = self._zero = 0
        self._configure()

    def receive(self, data: bytes) -> bytes:
        data, self._pending, answers = self._pending + data, b"", b""
        while data:
            length = LENGTHS.get(data[0], 1)
            if data[0] == protocol.EXG:
                length = 4 + data[3] if len(data) > 3 else 5
            if len(data) < length:
                self._pending = data
                break
            answers += self._obey(data[0], data[1:length])
            data = data[length:]
        return answers

    def say(self, seconds: float) -> list[bytes]:
        if not self._streaming:
            return []
        if self._began is None:
            self._began = seconds
        first, self._said = due(self._said, seconds - self._began, TICKS_HZ / self.divider)
        return self.packets(first, self._said)

    def restart(self) -> None:
        self._zero = self._said

    def packets(self, first: int, stop: int) -> list[bytes]:
        """Packets first..stop-1."""
        if stop <= first:
            return []
        table = self.counts(first, stop)
        ticks = 1000 + (np.arange(first, stop) - self._zero) * self.divider
        return [protocol.packet(t, self.channels, row) for t, row in zip(ticks.tolist(), table.tolist(), strict=True)]

    def counts(self, first: int, stop: int) -> Array:
        """What the packets first..stop-1 hold (n, channels)."""
        index = np.arange(first, stop)
        made = np.zeros((len(index), len(self.channels)), np.int64)
        hz = {"wide_acceleration": self.wide_hz, "angular_velocity": self.gyro_hz}
        names = [protocol.CHANNELS[c].name for c in self.channels]
        for name, channels in (("acceleration", "a"), ("wide_acceleration", "w"), ("angular_velocity", "g")):
            if channels + "x" in names:
                measured = self.limb.measure(self._held(index, hz.get(name, np.inf)))
                counts = self._known(name).counts(measured[name.removeprefix("wide_")])
                at = names.index(channels + "x")
                made[:, at : at + 3] = np.round(np.clip(counts, -32768, 32767))
        for i, name in enumerate(names):
            if name.startswith("exg"):
                made[:, i] = self._electrode(int(name[-1]) - 1, index)
            elif name.startswith("status"):
                made[:, i] = 0x80
        return made

    def _held(self, index: Times, hz: float) -> Times:
        """Of which sample a sensor of this rate shows the value: it stays until the next is measured."""
        rate = TICKS_HZ / self.divider
        return index if hz >= rate else np.floor(np.floor(index / rate * hz) / hz * rate).astype(np.int64)

    def _known(self, name: str) -> ShimmerCalibration:
        """By which the sensor measures: as calibrated, but for the ranges of the factory."""
        ranges = (self.wide_range, self.gyro_range, self.chips)
        now = units.nominal(name, *ranges)
        factor = now.sensitivity / units.nominal(name, chips=self.chips).sensitivity
        own = self.calibrated[name]
        kept = units.stored({name: ShimmerCalibration(own.offset, own.sensitivity * factor, own.alignment)})
        return units.calibration(kept, name, *ranges)

    def _electrode(self, channel: int, index: Times) -> Samples:
        """Counts (n,) of one electrode pair."""
        chip, place = divmod(channel, 2)
        gain = units.GAINS[self.registers[chip][3 + place] >> 4 & 7]
        at = np.round(index * 1000 * self.divider / TICKS_HZ).astype(np.int64)
        first = int(at[0])
        emg = self._emg.read(first, int(at[-1]) + 1)[0][at - first, channel]
        return np.asarray(np.round(emg * 1e-6 * gain * (2**23 - 1) / units.VREF_V))

    def _configure(self) -> None:
        rate_hz = TICKS_HZ / self.divider
        self.limb: Limb | Back = (
            Back("brisk", LONELY + self._seed, rate_hz)
            if self._site == "lower_back"
            else Limb(self._site, rate_hz, seed=self._seed)
        )

    def _obey(self, command: int, data: bytes) -> bytes:
        """One command; returns what the device answers."""
        ack = bytes([ACK])
        match command:
            case protocol.STOP:
                self._streaming = False
            case protocol.BATTERY:
                counts = round(self.battery_v / 3.0 / 1.988 * 4095)
                return ack + bytes([IN_STREAM, protocol.CHARGED]) + counts.to_bytes(2, "little") + b"\x80"
            case 0x72:
                return ack + bytes([IN_STREAM, protocol.STATUS, 0x10 * self._streaming])
            case _ if self._streaming:
                return ack
            case protocol.START:
                self._streaming, self._began, self._said, self._zero = True, None, 0, 0
            case protocol.FIRMWARE:
                major, minor, release = self._firmware
                version = [protocol.LOG_AND_STREAM, 0, major, 0, minor, release]
                return ack + bytes([protocol.VERSION, *version])
            case protocol.HARDWARE:
                return ack + bytes([protocol.MADE, protocol.SHIMMER3])
            case protocol.BOARD:
                return ack + bytes([protocol.BOARDED, data[0]]) + self._board[data[1] : data[1] + data[0]]
            case protocol.NAME:
                return ack + bytes([protocol.NAMED, 13]) + b"Shimmer3-5A1E"
            case protocol.INQUIRY:
                return ack + self._inquired()
            case protocol.CALIBRATION:
                own = {name: self._known(name) for name in self.calibrated}
                return ack + bytes([protocol.CALIBRATED]) + units.stored(own)
            case 0x63:
                return ack + bytes([0x62, data[2]]) + self.registers[data[0]][data[1] : data[1] + data[2]]
            case _:
                self._set(command, data)
        return ack

    def _set(self, command: int, data: bytes) -> None:
        match command:
            case protocol.SENSORS:
                bits = int.from_bytes(data, "little")
                on = [name for name in OUTPUTS if bits & protocol.SENSOR_BITS[name]]
                self.channels = sum((OUTPUTS[name] for name in on), ())
            case protocol.RATE:
                self.divider = max(1, int.from_bytes(data, "little"))
                self._configure()
            case protocol.WIDE_RANGE:
                self.wide_range = data[0] & 3
            case protocol.WIDE_RATE:
                self.wide_hz = self.chips.wide_hz[data[0] % len(self.chips.wide_hz)]
            case protocol.GYRO_RATE:
                self.gyro_hz = units.GYRO_HZ / (1 + data[0])
            case protocol.GYRO_RANGE:
                self.gyro_range = data[0] & 3
            case protocol.EXG:
                old, begin = self.registers[data[0] & 1], data[1]
                self.registers[data[0] & 1] = old[:begin] + data[3:] + old[begin + len(data) - 3 :]

    def _inquired(self) -> bytes:
        config = self.wide_range << 2 | self.gyro_range << 16
        head = self.divider.to_bytes(2, "little") + config.to_bytes(4, "little")
        return bytes([protocol.INQUIRED]) + head + bytes([len(self.channels), 1, *self.channels])


def simulated(source: Shimmer) -> AbstractContextManager[Shimmer]:
    """What `--simulate` puts in its place: with electrodes it is on a shank, else at the lower back."""
    return in_place(source, SimulatedShimmer(site="shank" if source.purpose else "lower_back"))
