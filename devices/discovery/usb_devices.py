"""USB devices that kinegraph reads without a serial port, known by their ids, and the node that reads each."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinegraph.devices.discovery.finders import FoundDevice
from kinegraph.devices.transport.usb_bus import UsbAddress, backends, connected, rule, text_of

MTI = "use: devices.mti.Mti\nport: {port}"
DUALSENSE = (
    "use: devices.usb.endpoint.Endpoint\nport: {port}\ninterface: 3\nframes: ...   # as in configs/dualsense.yaml"
)


@dataclass(frozen=True, slots=True)
class KnownUsbDevice:
    """What ids mean, and the node that reads it."""

    what: str
    yaml: str


KNOWN: dict[tuple[int, int | None], KnownUsbDevice] = {
    (0x2639, None): KnownUsbDevice("Xsens/Movella MTi", MTI),
    (0x054C, 0x0CE6): KnownUsbDevice("Sony DualSense controller", DUALSENSE),
    (0x054C, 0x0DF2): KnownUsbDevice("Sony DualSense Edge controller", DUALSENSE),
}
"""By USB vendor and product; None stands for any product."""


def find() -> Iterator[FoundDevice]:
    """Every known device; nothing is claimed. Raises DeviceError where libusb is missing."""
    backends()
    for device in connected():
        known = KNOWN.get((device.idVendor, device.idProduct)) or KNOWN.get((device.idVendor, None))
        if known is None:
            continue
        name, number = text_of(device, device.iProduct), text_of(device, device.iSerialNumber)
        where = UsbAddress(device.idVendor, device.idProduct, number or "")
        text = ", ".join(part for part in (name, number and f"serial number {number}") if part)
        allowed = number is not None and _may_write(device)
        note = "" if allowed else rule(UsbAddress(device.idVendor, device.idProduct))
        yield FoundDevice(
            "usb", str(where), f"{known.what} ({text})" if text else known.what, known.yaml.format(port=where), note
        )


def _may_write(device: Any) -> bool:
    """Whether the system lets this user open it, as far as its file says."""
    node = Path(f"/dev/bus/usb/{device.bus or 0:03d}/{device.address or 0:03d}")
    return not node.exists() or os.access(node, os.R_OK | os.W_OK)
