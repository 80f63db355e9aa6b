"""One connected Bluetooth LE device: notifications as they come, with their arrival; everything in the thread that reads."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from kinegraph.devices.transport.ble_radio import library, options, run, seek, uuid
from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed

LEAVE_S = 5.0
"""How long a device may take to let go."""


class Notification(NamedTuple):
    """What a characteristic has sent: its UUID, arrival (ns, session time), bytes."""

    characteristic: str
    arrival: int
    data: bytes


class BleLink(ClosesAtExit):
    """Finds a device, connects, and keeps what it notifies until it is fetched. bleak's loop runs while this link waits."""

    def __init__(self, feed: Feed, device: str, services: Sequence[str] = (), scan_s: float = 10.0) -> None:
        """Raises DeviceError that says who does advertise."""
        self._bleak, self._feed = library(), feed
        self._came: deque[Notification] = deque()
        self._gone = False
        self._runner = asyncio.Runner()
        self.name = device or services[0]
        try:
            self._client = self.run(self._connect(device, services, scan_s))
        except BaseException:
            self._runner.close()
            raise

    def run(self, work: Any) -> Any:
        """What a coroutine returns; raises DeviceError that names the device."""
        try:
            return run(self._runner, work)
        except DeviceError as error:
            raise DeviceError(f"{self.name}: {error}") from None

    async def _connect(self, device: str, services: Sequence[str], scan_s: float) -> Any:
        self._changed = asyncio.Event()
        found = await seek(device, services, scan_s)
        self.name = f"{found.name or 'a nameless device'} ({found.address})"
        client = self._bleak.BleakClient(found, disconnected_callback=self._left, timeout=scan_s, **options("client"))
        await client.connect()
        return client

    @property
    def mtu(self) -> int:
        """Bytes of a packet at most, as far as the system tells."""
        return int(self._client.mtu_size)

    def offers(self, characteristic: str) -> bool:
        return self._client.services.get_characteristic(uuid(characteristic)) is not None

    def subscribe(self, characteristic: str) -> None:
        """From here on, what it notifies or indicates is kept."""
        full = uuid(characteristic)

        def came(_: Any, data: bytearray) -> None:
            self._came.append(Notification(full, self._feed.now(), bytes(data)))
            self._changed.set()

        self._need(full)
        self.run(self._client.start_notify(full, came))

    def write(self, characteristic: str, data: bytes, *, response: bool = True) -> None:
        self._need(characteristic)
        self.run(self._client.write_gatt_char(uuid(characteristic), data, response=response))

    def ask(self, characteristic: str) -> bytes:
        """What a characteristic holds now."""
        self._need(characteristic)
        return bytes(self.run(self._client.read_gatt_char(uuid(characteristic))))

    def text(self, characteristic: str) -> str:
        """A text that a characteristic holds, or ""."""
        with suppress(DeviceError):
            return self.ask(characteristic).rstrip(b"\0").decode("utf-8", "replace").strip()
        return ""

    def answer(self, characteristic: str, begins: bytes, within_s: float) -> bytes:
        """The next notification of it that begins so; those before it stay. Raises DeviceError."""
        full, kept, passed = uuid(characteristic), list[Notification](), 0.0
        while passed < within_s:
            for note in (came := self.fetch(0.1)):
                if note.characteristic == full and note.data.startswith(begins):
                    kept += [other for other in came if other is not note]
                    self._came.extendleft(reversed(kept))
                    return note.data
            kept, passed = kept + came, passed + 0.1
            if self._feed.stopped:
                break
        self._came.extendleft(reversed(kept))
        raise DeviceError(f"{self.name} does not answer {begins.hex(' ')} within {within_s:g} s")

    def fetch(self, timeout_s: float) -> list[Notification]:
        """All that has come; waits for it if need be. Raises DeviceError when the device has left."""
        if not self._came and not self._gone:
            self._runner.run(self._wait(timeout_s))
        if self._gone and not self._came:
            raise DeviceError(f"{self.name} has disconnected: out of reach, or switched off")
        found = list(self._came)
        self._came.clear()
        return found

    async def _wait(self, timeout_s: float) -> None:
        self._changed.clear()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), timeout_s)

    def _left(self, _: Any) -> None:
        self._gone = True
        self._changed.set()

    def _need(self, characteristic: str) -> None:
        if not self.offers(characteristic):
            raise DeviceError(f"{self.name} has no characteristic {characteristic}; is it the device that is meant?")

    def close(self) -> None:
        """Let go of the device; never raises."""
        with suppress(DeviceError):
            self.run(asyncio.wait_for(self._client.disconnect(), LEAVE_S))
        self._runner.close()
