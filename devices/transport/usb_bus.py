"""Which USB devices are there, and what a failing one means: through pyusb, on libusb or on a simulated bus."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kinegraph.stream.errors import DeviceError

if TYPE_CHECKING:
    from usb.backend import IBackend

SCHEME = "usb://"
RULES = "/etc/udev/rules.d/70-kinegraph.rules"
_ADDRESS = re.compile(r"usb://(?P<vendor>[0-9a-f]{4})(?::(?P<product>[0-9a-f]{4}))?(?:/(?P<serial>[^/\s]+))?", re.I)

simulated: list[IBackend] = []
"""Buses that are looked at before the real one."""


@dataclass(frozen=True, slots=True)
class UsbAddress:
    """Which device: "usb://2639", "usb://2639:0003" or "usb://2639:0003/SERIAL"."""

    vendor: int
    product: int | None = None
    serial: str = ""

    @staticmethod
    def parse(text: str) -> UsbAddress:
        """Raises DeviceError for what is no such address."""
        match = _ADDRESS.fullmatch(text)
        if not match:
            raise DeviceError(
                f"{text!r} is not a USB address; write usb://VENDOR, usb://VENDOR:PRODUCT or usb://VENDOR:PRODUCT/SERIAL with "
                "hexadecimal ids of four digits, as in usb://2639:0003"
            )
        product = match["product"]
        return UsbAddress(int(match["vendor"], 16), int(product, 16) if product else None, match["serial"] or "")

    def __str__(self) -> str:
        product = "" if self.product is None else f":{self.product:04x}"
        return f"{SCHEME}{self.vendor:04x}{product}{self.serial and '/' + self.serial}"


def backends() -> list[IBackend]:
    """The simulated buses and the real one; raises DeviceError if there is no bus."""
    real = libusb()
    if real is None and not simulated:
        raise DeviceError(
            "libusb 1.0 is not there; install it (Debian: sudo apt install libusb-1.0-0; anywhere: pip install libusb-package)"
        )
    return [*simulated, *([real] if real else [])]


def libusb() -> IBackend | None:
    """The system's libusb, else that of the package libusb-package, else None."""
    import usb.backend.libusb1

    found = usb.backend.libusb1.get_backend()
    if found is None:
        try:
            import libusb_package
        except ImportError:
            return None
        found = libusb_package.get_libusb1_backend()
    return found


def connected() -> Iterator[Any]:
    """Every device (`usb.core.Device`) that can be seen; nothing is opened."""
    import usb.core

    for backend in backends():
        yield from usb.core.find(find_all=True, backend=backend) or ()


def find(address: UsbAddress) -> Any:
    """The device (`usb.core.Device`) at an address; raises DeviceError."""
    import usb.core

    try:
        here = [d for d in connected() if d.idVendor == address.vendor and address.product in (None, d.idProduct)]
    except usb.core.USBError as error:
        raise failure(str(address), error) from None
    if address.serial:
        numbers = [serial_number(d) for d in here]
        here = [d for d, number in zip(here, numbers, strict=True) if number == address.serial]
        if not here and None in numbers:
            raise DeviceError(f"{address}: not allowed to ask for serial numbers; {rule(address)}")
    if not here:
        others = [str(UsbAddress(d.idVendor, d.idProduct)) for d in connected()]
        like = [other for other in others if other.startswith(str(UsbAddress(address.vendor)))]
        hint = f"there is {like[0]}" if like else "`kinegraph devices usb` lists what is there"
        raise DeviceError(f"{address} is not there; is it plugged in? {hint}")
    if len(here) > 1:
        known = ", ".join(str(UsbAddress(d.idVendor, d.idProduct, serial_number(d) or "?")) for d in here)
        raise DeviceError(f"{address} may be any of {len(here)} devices; write which one: {known}")
    return here[0]


def serial_number(device: Any) -> str | None:
    """What the device says is its serial number, or "", None if it may not be asked."""
    return text_of(device, device.iSerialNumber)


def text_of(device: Any, index: int) -> str | None:
    """One of the device's texts, or "", None if it may not be asked."""
    import usb.core
    import usb.util

    try:
        return usb.util.get_string(device, index) or ""
    except (usb.core.USBError, ValueError, NotImplementedError):
        return None
    finally:
        usb.util.dispose_resources(device)


def who(device: Any) -> dict[str, str]:
    """What the device says of itself, as far as it does: ids, maker, product, serial number."""
    texts = {
        "maker": text_of(device, device.iManufacturer),
        "product": text_of(device, device.iProduct),
        "serial": serial_number(device),
    }
    return {"usb": f"{device.idVendor:04x}:{device.idProduct:04x}", **{k: v for k, v in texts.items() if v}}


def rule(address: UsbAddress) -> str:
    """What to do where permission is missing: the exact udev rule."""
    product = "" if address.product is None else f', ATTR{{idProduct}}=="{address.product:04x}"'
    line = f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{address.vendor:04x}"{product}, MODE="0660", TAG+="uaccess"'
    return (
        f"give yourself permission with this line in {RULES}:\n  {line}\n"
        "then: sudo udevadm control --reload && sudo udevadm trigger, and plug the device in again"
    )


def failure(address: str, error: OSError, device: UsbAddress | None = None) -> DeviceError:
    """What an error of pyusb means, and what can be done."""
    match error.errno:
        case errno.EACCES | errno.EPERM if device:
            reason = f"permission denied; {rule(device)}"
        case errno.EBUSY:
            reason = "another program or a driver of the system has it; close that one first"
        case errno.ENODEV | errno.ENXIO:
            reason = "it is gone (unplugged, or it has restarted)"
        case errno.EIO:
            reason = "it does not answer any more (a loose cable, or it is just being unplugged)"
        case errno.EOVERFLOW:
            reason = "it sent more than a transfer takes"
        case _:
            reason = error.strerror or str(error)
    return DeviceError(f"{address}: {reason}")
