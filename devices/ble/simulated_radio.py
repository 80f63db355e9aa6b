"""A simulated Bluetooth LE radio: backends for bleak, which is used unmodified, and the peripherals in its reach."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from kinegraph.devices.ble.simulated_peripheral import Peripheral, PeripheralInReach
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.transport import ble_radio as real_radio


class SimulatedRadio:
    """What bleak is given as its backend; `put` brings peripherals into reach."""

    def __init__(self) -> None:
        self.around: list[PeripheralInReach] = []
        from kinegraph.devices.ble.simulated_backends import bound

        self.client, self.scanner = bound(self.around)

    def put(self, peripheral: Peripheral, *, mtu: int = 247, faults: FaultInjection = GOOD) -> PeripheralInReach:
        here = PeripheralInReach(peripheral, f"C0:FF:EE:00:00:{len(self.around):02X}", mtu, faults)
        self.around.append(here)
        return here


@contextmanager
def radio() -> Iterator[SimulatedRadio]:
    """A radio that replaces the system's while the context lasts."""
    made = SimulatedRadio()
    real_radio.simulated.append(made)
    try:
        yield made
    finally:
        real_radio.simulated.remove(made)


@contextmanager
def in_reach(peripheral: Peripheral, faults: FaultInjection = GOOD) -> Iterator[PeripheralInReach]:
    """A radio with one peripheral in its reach."""
    with radio() as air:
        yield air.put(peripheral, faults=faults)
