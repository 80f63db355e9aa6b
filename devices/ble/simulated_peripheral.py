"""A simulated Bluetooth LE device, and where it is."""

from __future__ import annotations

import time
from typing import Protocol

from kinegraph.devices.simulation.fault_injection import FaultInjection, FaultInjector


class Peripheral(Protocol):
    """A simulated Bluetooth LE device without its radio. Characteristics are named as in `devices.transport.ble_radio.uuid`.

    services    by service, its characteristics with their properties
    advertised  the services that it advertises
    """

    name: str
    services: dict[str, dict[str, list[str]]]
    advertised: tuple[str, ...]

    def connected(self, yes: bool) -> None:
        """A host has come, or gone."""

    def hold(self, characteristic: str) -> bytes:
        """What a characteristic that is read holds."""

    def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        """Something was written; what is notified or indicated for it."""

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        """What was notified since the last call, up to this second since it was switched on."""


class PeripheralInReach:
    """A peripheral, its address, and whether it can be reached."""

    def __init__(self, peripheral: Peripheral, address: str, mtu: int, faults: FaultInjection) -> None:
        self.peripheral, self.address, self.mtu = peripheral, address, mtu
        self.injector, self.began = FaultInjector(faults), time.monotonic()
        self.in_reach = True

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began

    @property
    def reachable(self) -> bool:
        return self.in_reach and not self.injector.unplugged(self.seconds)
