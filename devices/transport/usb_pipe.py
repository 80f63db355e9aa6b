"""An open USB interface: its endpoint for reading and, if it has one, for writing, as a transport."""

from __future__ import annotations

import errno
from contextlib import suppress
from typing import Any

from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.devices.transport.usb_bus import UsbAddress, failure, find, who
from kinegraph.stream.errors import DeviceError

BULK, INTERRUPT = 2, 3
PACKETS = 64
"""Packets that one bulk transfer takes at most; it ends with the first that is not full."""
WRITE_MS = 1000
_KIND = {BULK: "bulk", INTERRUPT: "interrupt"}


class Pipe(ClosesAtExit):
    """An interface of a USB device, for this process alone. The system's own driver is detached, and put back at the end.

    A read is one transfer: of a bulk endpoint as many packets as are there, of an interrupt endpoint one report.
    """

    def __init__(self, address: str, interface: int | None = None, endpoint: int | None = None) -> None:
        """`endpoint`: the address of the one to read (0x81 to 0x8F); left out: the first bulk or interrupt one, as for `interface`."""
        import usb.core

        self.address = address
        self._where = UsbAddress.parse(address)
        self._device = find(self._where)
        self.identity = who(self._device)
        """What the device says of itself."""
        self._where = UsbAddress(self._device.idVendor, self._device.idProduct, self._where.serial)
        self._interface: int | None = None
        self._detached = False
        try:
            self._open(interface, endpoint)
        except usb.core.USBError as error:
            self.close()
            raise failure(address, error, self._where) from None
        except DeviceError:
            self.close()
            raise

    @property
    def device(self) -> Any:
        """The `usb.core.Device`."""
        return self._device

    def read(self, timeout_s: float) -> bytes:
        import usb.core

        try:
            n = self._in.read(self._buffer, max(1, round(timeout_s * 1000)))
        except usb.core.USBTimeoutError:
            return b""
        except usb.core.USBError as error:
            if error.errno != errno.EPIPE:
                raise failure(self.address, error, self._where) from None
            self._resume()
            return b""
        return self._view[:n].tobytes()

    def write(self, data: bytes) -> None:
        import usb.core

        if self._out is None:
            raise DeviceError(f"{self.address}: interface {self._interface} has no endpoint to write to")
        try:
            self._out.write(data, WRITE_MS)
        except usb.core.USBError as error:
            raise failure(self.address, error, self._where) from None

    def close(self) -> None:
        import usb.core
        import usb.util

        gone = (usb.core.USBError, NotImplementedError)
        with suppress(*gone):
            if self._interface is not None:
                usb.util.release_interface(self._device, self._interface)
            if self._detached:
                self._device.attach_kernel_driver(self._interface)
        with suppress(*gone):
            usb.util.dispose_resources(self._device)

    def _open(self, interface: int | None, endpoint: int | None) -> None:
        import usb.util

        chosen, self._in = self._choose(interface, endpoint)
        kind = usb.util.endpoint_type(self._in.bmAttributes)
        outs = [e for e in chosen if not e.bEndpointAddress & 0x80 and usb.util.endpoint_type(e.bmAttributes) == kind]
        self._out = outs[0] if outs else None
        number = chosen.bInterfaceNumber
        with suppress(NotImplementedError):
            if self._device.is_kernel_driver_active(number):
                self._device.detach_kernel_driver(number)
                self._detached = True
        self._interface = number
        usb.util.claim_interface(self._device, number)
        size = self._in.wMaxPacketSize & 0x7FF
        self._buffer = usb.util.create_buffer(size * PACKETS if kind == BULK else size)
        self._view = memoryview(self._buffer)

    def _choose(self, interface: int | None, endpoint: int | None) -> tuple[Any, Any]:
        """The interface and its endpoint to read; raises DeviceError with what there is."""
        import usb.util

        there = []
        for one in self._configuration():
            for e in one:
                kind = usb.util.endpoint_type(e.bmAttributes)
                if not e.bEndpointAddress & 0x80 or kind not in _KIND or one.bAlternateSetting:
                    continue
                if interface in (None, one.bInterfaceNumber) and endpoint in (None, e.bEndpointAddress):
                    return one, e
                there.append(f"interface {one.bInterfaceNumber} endpoint {e.bEndpointAddress:#04x} ({_KIND[kind]})")
        wanted = [f"interface {interface}"] * (interface is not None)
        wanted += [f"endpoint {endpoint:#04x}"] if endpoint is not None else []
        raise DeviceError(
            f"{self.address} has no {' '.join(wanted) or 'endpoint'} to read from; there is {'; '.join(there) or 'none'}"
        )

    def _configuration(self) -> Any:
        import usb.core

        try:
            return self._device.get_active_configuration()
        except usb.core.USBError as error:
            if error.errno is not None:
                raise
            self._device.set_configuration()
            return self._device.get_active_configuration()

    def _resume(self) -> None:
        """The endpoint has stalled: tell the device to go on."""
        import usb.core

        try:
            self._in.clear_halt()
        except usb.core.USBError as error:
            raise failure(self.address, error, self._where) from None
