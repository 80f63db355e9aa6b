"""Simulated USB devices that send reports: Sony's DualSense controller on a walking shank, and any other that a graph declares."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.people.walking_limb import GRAVITY, Limb
from kinegraph.devices.simulation.device_model import DeviceModel
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.devices.transport.usb_bus import UsbAddress
from kinegraph.devices.usb.endpoint import Endpoint
from kinegraph.devices.usb.simulated_bus import INTERRUPT, SimulatedBus, UsbLine, UsbWiring

DUALSENSE = UsbWiring(
    0x054C, 0x0CE6, "Sony Interactive Entertainment", "Wireless Controller", "SIM0001", INTERRUPT,
    interface=3, endpoint=4, driver="usbhid",
)  # fmt: skip
REPORTS_HZ = 250.0
DEG_S_PER_COUNT, G_PER_COUNT = 0.0625, 1 / 8192
TICKS_HZ = 3_000_000
MAX_BEHIND = 2500


@contextmanager
def serving(source: Endpoint, faults: FaultInjection = GOOD) -> Iterator[str]:
    """The address of a device, on a simulated USB bus of this process, that sends what `source` reads."""
    where = UsbAddress.parse(source.port)
    if (where.vendor, where.product) == (DUALSENSE.vendor, DUALSENSE.product):
        brain: DeviceModel = DualSenseBrain()
        wiring = DUALSENSE
    else:
        brain = BinaryModel(source)
        number = (source.endpoint or 0x81) & 0x0F
        size = max(layout.size for layout in source.layouts())
        wiring = UsbWiring(
            where.vendor, where.product or 1, "kinegraph", "as declared", where.serial or "SIM0001", INTERRUPT,
            packet=size, interface=source.interface or 0, endpoint=number,
        )  # fmt: skip
    with Server(brain, UsbLine(SimulatedBus.shared(), wiring), faults) as server:
        yield server.address


class DualSenseBrain:
    """The controller's inertial unit, without a cable; strapped to a shank that walks. Report i is sample i of `limb`.

    The layout is that of the Linux driver hid-playstation: 64 bytes with id 01, counter at 7, gyroscope at 16, accelerometer at 22, time in
    thirds of a microsecond at 28, battery at 53; little-endian.
    """

    def __init__(self, seed: int = 0) -> None:
        self.limb = Limb("shank", REPORTS_HZ, seed=seed)
        self._said = self._zero = 0

    def receive(self, data: bytes) -> bytes:
        return b""

    def say(self, seconds: float) -> list[bytes]:
        due = int(seconds * REPORTS_HZ)
        first = max(self._said, due - MAX_BEHIND)
        self._said = max(first, due)
        return self.reports(first, self._said)

    def restart(self) -> None:
        self._zero = self._said

    def reports(self, first: int, stop: int) -> list[bytes]:
        """Reports first..stop-1."""
        if stop <= first:
            return []
        made = self.limb.measure(np.arange(first, stop))
        gyro = np.round(np.rad2deg(made["angular_velocity"]) / DEG_S_PER_COUNT)
        accel = np.round(made["acceleration"] / GRAVITY / G_PER_COUNT)
        counts = np.clip(np.hstack([gyro, accel]), -32768, 32767).astype(int)
        return [self._report(first + i, row) for i, row in enumerate(counts.tolist())]

    def _report(self, number: int, counts: list[int]) -> bytes:
        since = number - self._zero
        report = bytearray(64)
        report[0] = 0x01
        report[1:5] = b"\x80\x80\x80\x80"
        report[7] = since % 256
        report[8] = 0x08
        struct.pack_into("<6hI", report, 16, *counts, round(since * TICKS_HZ / REPORTS_HZ) % 2**32)
        report[33] = report[37] = 0x80
        report[53] = 0x0A
        return bytes(report)


@contextmanager
def simulated(source: Endpoint) -> Iterator[Endpoint]:
    """What `--simulate` puts in its place."""
    with serving(source) as address:
        yield replace(source, port=address)
