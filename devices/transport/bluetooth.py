"""Bytes that a Bluetooth LE device notifies, behind the interface of a serial port: each read gives one notification."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress

from kinegraph.devices.transport.ble_link import BleLink
from kinegraph.devices.transport.ble_radio import uuid
from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.stream.errors import DeviceError

SCHEME = "ble://"
SCAN_S = 10.0


class _Clock:
    """A link's feed, where only the time matters."""

    stopped = False

    @staticmethod
    def now() -> int:
        return time.monotonic_ns()


class BleTransport(ClosesAtExit):
    """ "ble://DEVICE/NOTIFY" or "ble://DEVICE/NOTIFY/WRITE": a device's name or address, and the UUIDs of two characteristics."""

    def __init__(self, address: str) -> None:
        self.address = address
        device, self._notify, self._write = parse(address)
        self._link = BleLink(_Clock(), device, (), SCAN_S)  # type: ignore[arg-type]
        self._came: deque[bytes] = deque()
        try:
            self._link.subscribe(self._notify)
        except DeviceError:
            self._link.close()
            raise

    def read(self, timeout_s: float) -> bytes:
        if not self._came:
            self._came.extend(note.data for note in self._link.fetch(timeout_s))
        return self._came.popleft() if self._came else b""

    def write(self, data: bytes) -> None:
        if not self._write:
            raise DeviceError(f"{self.address} names no characteristic to write to; write ble://DEVICE/NOTIFY/WRITE")
        self._link.write(self._write, data, response=False)

    def close(self) -> None:
        with suppress(DeviceError):
            self._link.close()


def parse(address: str) -> tuple[str, str, str]:
    """Device, notifying and written characteristic ("": unused); raises DeviceError."""
    device, *uuids = address.removeprefix(SCHEME).split("/")
    if not device or len(uuids) not in (1, 2):
        raise DeviceError(
            f"{address!r} is not a Bluetooth LE address; write ble://DEVICE/NOTIFY or ble://DEVICE/NOTIFY/WRITE, with the device's "
            "name or address and the UUIDs of its characteristics"
        )
    return device, uuid(uuids[0]), uuid(uuids[1]) if len(uuids) == 2 else ""
