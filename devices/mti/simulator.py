"""A simulated Xsens/Movella MTi on a walking person's foot, shank or lower back: its answers to commands and its measurements."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from kinegraph.devices.mti import xbus, xbus_numbers
from kinegraph.devices.people.walking_back import Back, Manner
from kinegraph.devices.people.walking_limb import Limb, Site
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.sample_schedule import due
from kinegraph.devices.simulation.serve import Server, Simulator, in_place
from kinegraph.devices.simulation.shared_walk import WALK
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.mti.source import Mti

FASTEST_HZ = {
    xbus.ACCELERATION: 400, xbus.RATE_OF_TURN: 400, xbus.QUATERNION: 400, xbus.MAGNETIC_FIELD: 100,
    xbus.ACCELERATION_HR: 2000, xbus.RATE_OF_TURN_HR: 2000,
}  # fmt: skip
QUANTITY = {
    xbus.ACCELERATION: "acceleration", xbus.ACCELERATION_HR: "acceleration", xbus.RATE_OF_TURN: "angular_velocity",
    xbus.RATE_OF_TURN_HR: "angular_velocity", xbus.QUATERNION: "orientation", xbus.MAGNETIC_FIELD: "magnetic_field",
}  # fmt: skip
FORMATS = (">f4", ">i4", "", ">f8")
FACTORY = ((xbus.PACKET_COUNTER, 0xFFFF), (xbus.SAMPLE_TIME_FINE, 0xFFFF), (xbus.QUATERNION, 100))


@dataclass(frozen=True, slots=True)
class SimulatedMti(Simulator):
    """An MTi on the right foot (or shank) of someone who walks; on a serial line, it measures on command."""

    port_name: ClassVar[str] = "ttyMTI"

    site: Site | Literal["lower_back"] = param("foot", help="where it is worn: foot, shank or lower_back")
    manner: Manner = param("brisk", help="at the lower back: brisk or shuffling")
    cadence_per_min: float = param(57.0, least=20, most=120, help="strides per minute")
    seed: int = param(0, least=0, help="another seed, another walk")

    def brain(self) -> MtiModel:
        return MtiModel(self.site, self.cadence_per_min, self.seed, self.manner)

    @contextmanager
    def on_usb(self, faults: FaultInjection = GOOD) -> Iterator[str]:
        """While the context lasts, the device is on a simulated USB bus of this process; gives what the host opens."""
        from kinegraph.devices.usb.simulated_bus import BULK, SimulatedBus, UsbLine, UsbWiring

        wiring = UsbWiring(0x2639, 0x0003, "Xsens", "MTi-300 AHRS", "SIM03700001", BULK, driver="xsens_mt")
        line = UsbLine(SimulatedBus.shared(), wiring)
        with Server(self.brain(), line, faults) as server:
            yield server.address


class MtiModel:
    """The sensor without a cable. Measurement i after GoToMeasurement is sample i of `limb`, and its packet counter is i mod 65536."""

    def __init__(
        self,
        site: Site | Literal["lower_back"] = "foot",
        cadence_per_min: float = 57.0,
        seed: int = 0,
        manner: Manner = "brisk",
    ) -> None:
        xbus_numbers.prepare()
        self._site, self._cadence, self._seed, self._manner = site, cadence_per_min, seed, manner
        self._decoder = xbus.XbusDecoder()
        self._outputs = list(FACTORY)
        self._configure()
        self._measuring = True
        """As it comes from the factory, it measures when it is switched on."""
        self._began: float | None = None
        self._said = self._zero = 0
        self._ahead = 0
        """At which sample of the walk measurement 0 lies."""
        self.ahead_s = 0.0
        self.stored = 0
        """How often settings were written into its lasting memory."""

    def receive(self, data: bytes) -> bytes:
        runs = self._decoder.feed(data).runs
        return b"".join(self._obey(run.mid, run.data) for run in runs for _ in range(len(run)))

    def say(self, seconds: float) -> list[bytes]:
        if not self._measuring or not self.rate_hz:
            return []
        if self._began is None:
            self._began, self._ahead = seconds, WALK.samples(self.rate_hz)
        first, self._said = due(self._said, seconds - self._began, self.rate_hz)
        return self.packets(first, self._said)

    def restart(self) -> None:
        self._zero = self._said

    def packets(self, first: int, stop: int) -> list[bytes]:
        """Measurements first..stop-1 as messages."""
        if stop <= first:
            return []
        index = np.arange(first, stop)
        since = index - self._zero
        measured = self.limb.measure(index + self._ahead)
        table = np.zeros(len(index), self._dtype)
        for name, (identifier, _) in zip(self._dtype.names or (), self._outputs, strict=True):
            kind = identifier & xbus.KIND
            table[f"{name}"]["head"] = (identifier, table.dtype[name]["data"].itemsize)
            if kind == xbus.PACKET_COUNTER:
                table[name]["data"] = since % 2**16
            elif kind == xbus.SAMPLE_TIME_FINE:
                ticks = np.round(since * xbus.TICKS_HZ / self.rate_hz).astype(np.int64)
                table[name]["data"] = (ticks + round(self.ahead_s * xbus.TICKS_HZ)) % 2**32
            else:
                scale = 2**20 if identifier & 3 == 1 else 1
                table[name]["data"] = measured[QUANTITY[kind]] * scale
        return [xbus.message(xbus.MEASUREMENT, row.tobytes()) for row in table]

    def _obey(self, mid: int, data: bytes) -> bytes:
        """One message; returns the answer."""
        match mid:
            case xbus.GO_TO_CONFIG:
                self._measuring = False
            case xbus.GO_TO_MEASUREMENT:
                self._measuring, self._began, self._said, self._zero = True, None, 0, 0
            case _ if self._measuring:
                return xbus.message(xbus.ERROR, b"\x04")
            case xbus.REQUEST_DEVICE_ID:
                return xbus.message(xbus.DEVICE_ID, bytes.fromhex("03700001"))
            case xbus.REQUEST_PRODUCT:
                return xbus.message(mid + 1, b"MTi-300-2A5G4       ")
            case xbus.REQUEST_FIRMWARE:
                return xbus.message(mid + 1, bytes([1, 8, 2]) + bytes(8))
            case xbus.OUTPUT_CONFIGURATION:
                if data:
                    self._outputs = [(i, self._possible_rate(i, rate)) for i, rate in xbus.outputs_of(data)]
                    self.stored += 1
                    self._configure()
                return xbus.message(mid + 1, xbus.configuration(self._outputs))
            case _:
                return xbus.message(xbus.ERROR, b"\x04")
        return xbus.message(mid + 1)

    def _worn(self, rate_hz: float) -> Limb | Back:
        if self._site == "lower_back":
            return Back(self._manner, self._seed, rate_hz)
        return Limb(self._site, rate_hz, self._cadence, self._seed)

    def _possible_rate(self, identifier: int, rate: int) -> int:
        """What it gives where it is asked for `rate`: at most its fastest."""
        fastest = FASTEST_HZ.get(identifier & xbus.KIND)
        return xbus.EVERY_PACKET if fastest is None else min(rate, fastest)

    def _configure(self) -> None:
        rates = [rate for _, rate in self._outputs if rate != xbus.EVERY_PACKET]
        self.rate_hz = max(rates, default=0)
        self.limb = self._worn(float(self.rate_hz or 100))
        self._dtype = np.dtype([(f"{i:04x}", _item(i)) for i, _ in self._outputs])


def _item(identifier: int) -> np.dtype[np.void]:
    """An item of a measurement: identifier, size, data."""
    counters = {xbus.PACKET_COUNTER: ">u2", xbus.SAMPLE_TIME_FINE: ">u4"}
    kind = identifier & xbus.KIND
    data = counters.get(kind) or (FORMATS[identifier & 3], (4 if kind == xbus.QUATERNION else 3,))
    return np.dtype(
        [("head", [("id", ">u2"), ("size", "u1")]), ("data", *(data if isinstance(data, tuple) else (data,)))]
    )


@contextmanager
def simulated(source: Mti) -> Iterator[Mti]:
    """What `--simulate` puts in its place."""
    device = SimulatedMti()
    if not source.port.startswith("usb://"):
        with in_place(source, device) as simulated_source:
            yield simulated_source
        return
    with WALK.watched(), device.on_usb() as address:
        yield replace(source, port=address)
