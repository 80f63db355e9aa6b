"""bleak's two backend classes for a simulated radio."""

from __future__ import annotations

import asyncio
from typing import Any, ClassVar

from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient
from bleak.backends.scanner import AdvertisementData, BaseBleakScanner
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import BleakError

from kinegraph.devices.ble.simulated_peripheral import PeripheralInReach
from kinegraph.devices.transport.ble_radio import uuid

TICK_S = 0.004


def bound(around: list[PeripheralInReach]) -> tuple[type[BaseBleakClient], type[BaseBleakScanner]]:
    """The two classes, bound to what is around a radio: bleak makes instances of them itself."""
    client = type("BoundClient", (SimulatedClient,), {"around": around})
    return client, type("BoundScanner", (SimulatedScanner,), {"around": around})


def table(here: PeripheralInReach) -> BleakGATTServiceCollection:
    """The services of a peripheral, as bleak holds them."""
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
    """Hears what the peripherals around it advertise, if they are within reach, once, as soon as it starts."""

    around: ClassVar[list[PeripheralInReach]]

    def __init__(self, detection_callback: Any, service_uuids: Any, scanning_mode: Any = "active", **_: Any) -> None:
        super().__init__(detection_callback, service_uuids)

    async def start(self) -> None:
        self.seen_devices = {}
        asyncio.get_running_loop().call_soon(self._announce)

    async def stop(self) -> None: ...

    def _announce(self) -> None:
        for here in self.around:
            if here.reachable:
                services = [uuid(one) for one in here.peripheral.advertised]
                result = AdvertisementData(here.peripheral.name, {}, {}, services, None, -50, ())
                device = self.create_or_update_device(here.address, here.address, here.peripheral.name, here, result)
                self.call_detection_callbacks(device, result)


class SimulatedClient(BaseBleakClient):
    """A connection with a peripheral `around`, as long as that is within reach."""

    around: ClassVar[list[PeripheralInReach]]

    def __init__(self, device: Any, **more: Any) -> None:
        kept = {k: v for k, v in more.items() if k in ("disconnected_callback", "timeout")}
        super().__init__(device, **kept)
        by_address = [h for h in self.around if h.address == self.address]
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
        self._here.peripheral.say(self._here.seconds)  # what came before the connection reaches no host
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
            result = here.peripheral.say(here.seconds)
            if not here.injector.stalled(here.seconds):
                self._pass(result)

    def _pass(self, packets: list[tuple[str, bytes]]) -> None:
        for name, data in packets:
            cut = data[: self._here.mtu - 3]
            for one in self._here.injector.spoil([cut], self._here.seconds):
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
        self._pass(
            self._here.peripheral.say(self._here.seconds)
        )  # a start is when it is written, however late this thread is
        result = self._here.peripheral.receive(characteristic.uuid, bytes(data))
        asyncio.get_running_loop().call_soon(self._answer, result)

    def _answer(self, replies: list[tuple[str, bytes]]) -> None:
        for name, data in replies:
            if handler := self._listening.get(uuid(name)):
                handler(bytearray(data))

    async def write_gatt_descriptor(self, descriptor: Any, data: Any) -> None: ...

    async def start_notify(self, characteristic: Any, callback: Any, **_: Any) -> None:
        self._listening[characteristic.uuid] = callback

    async def stop_notify(self, characteristic: Any) -> None:
        self._listening.pop(characteristic.uuid, None)
