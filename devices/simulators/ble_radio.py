"""A simulated Bluetooth LE radio: backends for bleak, which is used unmodified, and the peripherals in its reach."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from devices.ble import radio as real_radio
from devices.ble.radio import uuid
from devices.simulators.misbehaviour import GOOD, Misbehaviour, Mishaps

if TYPE_CHECKING:
    from bleak.backends.client import BaseBleakClient
    from bleak.backends.scanner import BaseBleakScanner

TICK_S = 0.004


class Peripheral(Protocol):
    """A simulated Bluetooth LE device without its radio. Characteristics are named as in `devices.ble.radio.uuid`.

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

    def hear(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        """Something was written; what is notified or indicated for it."""

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        """What was notified since the last call, up to this second since it was switched on."""


class PeripheralInReach:
    """A peripheral, its address, and whether it can be reached."""

    def __init__(self, peripheral: Peripheral, address: str, mtu: int, misbehaviour: Misbehaviour) -> None:
        self.peripheral, self.address, self.mtu = peripheral, address, mtu
        self.mishaps, self.began = Mishaps(misbehaviour), time.monotonic()
        self.in_reach = True

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began

    @property
    def reachable(self) -> bool:
        return self.in_reach and not self.mishaps.unplugged(self.seconds)


class SimulatedRadio:
    """What bleak is given as its backend; `put` brings peripherals into reach."""

    def __init__(self) -> None:
        self.around: list[PeripheralInReach] = []
        self.client, self.scanner = _backends(self)

    def put(self, peripheral: Peripheral, *, mtu: int = 247, misbehaviour: Misbehaviour = GOOD) -> PeripheralInReach:
        here = PeripheralInReach(peripheral, f"C0:FF:EE:00:00:{len(self.around):02X}", mtu, misbehaviour)
        self.around.append(here)
        return here


@contextmanager
def radio() -> Iterator[SimulatedRadio]:
    """A radio that stands in for the system's while the context lasts."""
    made = SimulatedRadio()
    real_radio.simulated.append(made)
    try:
        yield made
    finally:
        real_radio.simulated.remove(made)


def _backends(made: SimulatedRadio) -> tuple[type[BaseBleakClient], type[BaseBleakScanner]]:
    """bleak's two classes, bound to a radio: bleak makes instances of them itself."""
    from bleak.backends.characteristic import BleakGATTCharacteristic
    from bleak.backends.client import BaseBleakClient
    from bleak.backends.scanner import AdvertisementData, BaseBleakScanner
    from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
    from bleak.exc import BleakError

    def table(here: PeripheralInReach) -> BleakGATTServiceCollection:
        found, handle = BleakGATTServiceCollection(), 1
        for service, characteristics in here.peripheral.services.items():
            one = BleakGATTService(None, handle, uuid(service))
            found.add_service(one)
            for name, listed in characteristics.items():
                properties: Any = listed
                handle += 2
                found.add_characteristic(
                    BleakGATTCharacteristic(None, handle, uuid(name), properties, lambda: here.mtu - 3, one)
                )
            handle += 1
        return found

    class SimulatedScanner(BaseBleakScanner):
        def __init__(
            self, detection_callback: Any, service_uuids: Any, scanning_mode: Any = "active", **_: Any
        ) -> None:
            super().__init__(detection_callback, service_uuids)

        async def start(self) -> None:
            self.seen_devices = {}
            asyncio.get_running_loop().call_soon(self._announce)

        async def stop(self) -> None: ...

        def _announce(self) -> None:
            for here in made.around:
                if here.reachable:
                    services = [uuid(one) for one in here.peripheral.advertised]
                    said = AdvertisementData(here.peripheral.name, {}, {}, services, None, -50, ())
                    device = self.create_or_update_device(here.address, here.address, here.peripheral.name, here, said)
                    self.call_detection_callbacks(device, said)

    class SimulatedClient(BaseBleakClient):
        made_by: ClassVar[SimulatedRadio] = made

        def __init__(self, device: Any, **more: Any) -> None:
            kept = {k: v for k, v in more.items() if k in ("disconnected_callback", "timeout")}
            super().__init__(device, **kept)
            by_address = [h for h in made.around if h.address == self.address]
            self._here: PeripheralInReach = getattr(device, "details", None) or by_address[0]
            self._listening: dict[str, Any] = {}
            self._task: asyncio.Task[None] | None = None

        @property
        def name(self) -> str:
            return self._here.peripheral.name

        @property
        def mtu_size(self) -> int:
            return self._here.mtu

        @property
        def is_connected(self) -> bool:
            return self._task is not None

        async def connect(self, pair: bool, **_: Any) -> None:
            if not self._here.reachable:
                raise BleakError(f"{self.address} cannot be reached")
            self.services = table(self._here)
            self._here.peripheral.connected(True)
            self._task = asyncio.create_task(self._work())

        async def disconnect(self) -> None:
            if self._task is not None:
                self._task.cancel()
                self._leave()

        def _leave(self) -> None:
            self._task = None
            self._here.peripheral.connected(False)
            if self._disconnected_callback:
                self._disconnected_callback()

        async def _work(self) -> None:
            while True:
                await asyncio.sleep(TICK_S)
                here = self._here
                if not here.reachable:
                    self._leave()
                    return
                said = here.peripheral.say(here.seconds)
                if not here.mishaps.stalled(here.seconds):
                    self._pass(said)

        def _pass(self, said: list[tuple[str, bytes]]) -> None:
            for name, data in said:
                cut = data[: self._here.mtu - 3]
                for one in self._here.mishaps.spoil([cut], self._here.seconds):
                    if handler := self._listening.get(uuid(name)):
                        handler(bytearray(one))

        async def pair(self, *_: Any, **__: Any) -> None: ...

        async def unpair(self) -> None: ...

        async def read_gatt_char(self, characteristic: Any, **_: Any) -> bytearray:
            return bytearray(self._here.peripheral.hold(characteristic.uuid))

        async def read_gatt_descriptor(self, descriptor: Any, **_: Any) -> bytearray:
            return bytearray()

        async def write_gatt_char(self, characteristic: Any, data: Any, response: bool) -> None:
            if self._task is None:
                raise BleakError("not connected")
            said = self._here.peripheral.hear(characteristic.uuid, bytes(data))
            asyncio.get_running_loop().call_soon(self._answer, said)

        def _answer(self, said: list[tuple[str, bytes]]) -> None:
            for name, data in said:
                if handler := self._listening.get(uuid(name)):
                    handler(bytearray(data))

        async def write_gatt_descriptor(self, descriptor: Any, data: Any) -> None: ...

        async def start_notify(self, characteristic: Any, callback: Any, **_: Any) -> None:
            self._listening[characteristic.uuid] = callback

        async def stop_notify(self, characteristic: Any) -> None:
            self._listening.pop(characteristic.uuid, None)

    return SimulatedClient, SimulatedScanner
