"""A simulated USB bus: a backend for pyusb, which is used unmodified, and the devices' end of the cable."""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from kinegraph.devices.transport import usb_bus as real_bus
from kinegraph.devices.transport.usb_bus import UsbAddress
from kinegraph.devices.transport.usb_pipe import BULK, INTERRUPT

__all__ = ["BULK", "INTERRUPT", "SimulatedBus", "UsbLine", "UsbWiring"]

MAX_WAITING = 4096
"""Packets that wait for the host at most; what comes on top is lost."""
_ENGLISH = b"\x04\x03\x09\x04"
_GET_DESCRIPTOR, _STRING = 6, 3


@dataclass(frozen=True, slots=True)
class UsbWiring:
    """What a device says of itself.

    transfer    BULK (with an endpoint to write to) or INTERRUPT
    packet      bytes of a packet at most
    endpoint    its endpoints' number
    driver      the system's driver that has it until it is detached; "": no driver
    permitted   whether the user may open it
    """

    vendor: int
    product: int
    manufacturer: str
    name: str
    serial: str
    transfer: int = BULK
    packet: int = 64
    interface: int = 0
    endpoint: int = 1
    driver: str = ""
    permitted: bool = True


class _Plugged:
    """A device that is plugged in, until it is not."""

    def __init__(self, wiring: UsbWiring, address: int) -> None:
        self.wiring, self.address = wiring, address
        self.changed = threading.Condition()
        self.to_host: deque[bytes] = deque()
        self.from_host = bytearray()
        self.driver = bool(wiring.driver)
        self.gone = False
        self.claimed_by: object | None = None


class _Handle:
    def __init__(self, device: _Plugged) -> None:
        self.device = device


class SimulatedBus(IBackend):  # type: ignore[misc]
    """Devices are plugged in and pulled out by `UsbLine`; `handles` are those that the host has open."""

    _one: SimulatedBus | None = None

    @classmethod
    def shared(cls) -> SimulatedBus:
        """The one of this process."""
        if cls._one is None:
            cls._one = cls()
        return cls._one

    def __init__(self) -> None:
        self.devices: list[_Plugged] = []
        self.handles: set[_Handle] = set()
        self.detached = self.attached = 0
        """How often a driver of the system was."""
        self._plugged = 0

    def plug(self, wiring: UsbWiring) -> _Plugged:
        self._plugged += 1
        device = _Plugged(wiring, self._plugged)
        self.devices.append(device)
        return device

    def unplug(self, device: _Plugged) -> None:
        with device.changed:
            device.gone = True
            device.to_host.clear()
            device.changed.notify_all()
        self.devices.remove(device)

    # what pyusb asks for ---------------------------------------------------------------------------------------------

    def enumerate_devices(self) -> Iterator[_Plugged]:
        yield from list(self.devices)

    def get_parent(self, dev: _Plugged) -> None:
        return None

    def get_device_descriptor(self, dev: _Plugged) -> SimpleNamespace:
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=dev.wiring.vendor, idProduct=dev.wiring.product, bcdDevice=0x0100,
            iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
            address=dev.address, bus=99, port_number=dev.address, port_numbers=(dev.address,), speed=2,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: _Plugged, config: int) -> SimpleNamespace:
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0x80, bMaxPower=50, extra_descriptors=[], interfaces=1,
        )  # fmt: skip

    def get_interface_descriptor(self, dev: _Plugged, intf: int, alt: int, config: int) -> SimpleNamespace:
        if intf or alt or config:
            raise IndexError(intf)
        hid = dev.wiring.transfer == INTERRUPT
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=dev.wiring.interface, bAlternateSetting=0,
            bNumEndpoints=2, bInterfaceClass=3 if hid else 0xFF, bInterfaceSubClass=0, bInterfaceProtocol=0,
            iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: _Plugged, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(0x80, 0)[ep] | dev.wiring.endpoint, bmAttributes=dev.wiring.transfer,
            wMaxPacketSize=dev.wiring.packet, bInterval=4, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: _Plugged) -> _Handle:
        _there(dev)
        if not dev.wiring.permitted:
            raise USBError("Access denied (insufficient permissions)", -3, errno.EACCES)
        handle = _Handle(dev)
        self.handles.add(handle)
        return handle

    def close_device(self, dev_handle: _Handle) -> None:
        self._let_go(dev_handle)
        self.handles.discard(dev_handle)

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        _there(dev_handle.device)

    def get_configuration(self, dev_handle: _Handle) -> int:
        _there(dev_handle.device)
        return 1

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        device = _there(dev_handle.device)
        if device.driver or device.claimed_by not in (None, dev_handle):
            raise USBError("Resource busy", -6, errno.EBUSY)
        device.claimed_by = dev_handle

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        _there(dev_handle.device)
        self._let_go(dev_handle)

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        return _there(dev_handle.device).driver

    def detach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        _there(dev_handle.device).driver = False
        self.detached += 1

    def attach_kernel_driver(self, dev_handle: _Handle, intf: int) -> None:
        _there(dev_handle.device).driver = True
        self.attached += 1

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        _there(dev_handle.device)

    def reset_device(self, dev_handle: _Handle) -> None:
        _there(dev_handle.device)

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: Any, timeout: int) -> int:
        device = _there(dev_handle.device)
        with device.changed:
            device.from_host += data.tobytes()
            device.changed.notify_all()
        return len(data)

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """One transfer: it ends with a packet that is not full, or when the buffer is."""
        device, view, n = dev_handle.device, memoryview(buff), 0
        with device.changed:
            if not device.changed.wait_for(lambda: device.to_host or device.gone, timeout / 1000):
                raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
            _there(device)
            while device.to_host and n + len(device.to_host[0]) <= len(view):
                packet = device.to_host.popleft()
                view[n : n + len(packet)] = packet
                n += len(packet)
                if len(packet) < device.wiring.packet or device.wiring.transfer == INTERRUPT:
                    return n
            if not n:
                raise USBError("Overflow", -8, errno.EOVERFLOW)
        return n

    intr_read, intr_write = bulk_read, bulk_write

    def ctrl_transfer(
        self, dev_handle: _Handle, bmRequestType: int, bRequest: int, wValue: int, wIndex: int, data: Any, timeout: int
    ) -> int:
        """Texts are all that can be asked for."""
        device = _there(dev_handle.device)
        if bmRequestType != 0x80 or bRequest != _GET_DESCRIPTOR or wValue >> 8 != _STRING:
            raise USBError("Pipe error", -9, errno.EPIPE)
        texts = (device.wiring.manufacturer, device.wiring.name, device.wiring.serial)
        answer = _ENGLISH
        if wValue & 0xFF:
            text = texts[(wValue & 0xFF) - 1].encode("utf-16-le")
            answer = bytes([2 + len(text), _STRING]) + text
        n = min(len(answer), len(data))
        memoryview(data)[:n] = answer[:n]
        return n

    def _let_go(self, handle: _Handle) -> None:
        if handle.device.claimed_by is handle:
            handle.device.claimed_by = None


def _there(device: _Plugged) -> _Plugged:
    """The device; raises what libusb does if it has been pulled out."""
    if device.gone:
        raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
    return device


class UsbLine:
    """The device's end of a USB cable. What it sends while it is unclaimed is lost."""

    def __init__(self, bus: SimulatedBus, wiring: UsbWiring) -> None:
        self._bus, self._wiring = bus, wiring
        self.address = str(UsbAddress(wiring.vendor, wiring.product, wiring.serial))
        self._device: _Plugged | None = None
        if bus not in real_bus.simulated:
            real_bus.simulated.append(bus)
        self.plug()

    def plug(self) -> None:
        if self._device is None:
            self._device = self._bus.plug(self._wiring)

    def unplug(self) -> None:
        if self._device is not None:
            self._bus.unplug(self._device)
            self._device = None

    def read(self, timeout_s: float) -> bytes:
        device = self._device
        if device is None:
            time.sleep(timeout_s)
            return b""
        with device.changed:
            device.changed.wait_for(lambda: device.from_host, timeout_s)
            data = bytes(device.from_host)
            device.from_host.clear()
        return data

    def write(self, data: bytes) -> None:
        device = self._device
        if device is None or device.claimed_by is None or not data:
            return
        size = self._wiring.packet
        with device.changed:
            for at in range(0, len(data), size):
                if len(device.to_host) < MAX_WAITING:
                    device.to_host.append(data[at : at + size])
            if len(data) % size == 0 and self._wiring.transfer == BULK:
                device.to_host.append(b"")
            device.changed.notify_all()

    def close(self) -> None:
        self.unplug()
        if not self._bus.devices and self._bus in real_bus.simulated:
            real_bus.simulated.remove(self._bus)
