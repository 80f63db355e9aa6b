"""The Bluetooth LE radio: bleak, on the system's radio or on a simulated one; who advertises, and which of them is meant."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.extras import optional

if TYPE_CHECKING:
    from bleak.backends.client import BaseBleakClient
    from bleak.backends.scanner import BaseBleakScanner

SHOWN = 8
PROBE_S = 1.5
"""So long a device is looked for before a session."""


class Radio(Protocol):
    """Backends of bleak that replace the system's."""

    client: type[BaseBleakClient]
    scanner: type[BaseBleakScanner]


simulated: list[Radio] = []
"""Radios that are used in place of the real one; the last one put in."""


def library() -> Any:
    """bleak; raises DeviceError that says how to install it."""
    return optional("bleak", "Bluetooth LE", "pip install 'kinegraph[ble]'", DeviceError)


def uuid(text: str) -> str:
    """A UUID in full and in small letters; "2a37" is one of Bluetooth's own. Raises DeviceError."""
    short = text.lower().removeprefix("0x")
    if len(short) in (4, 8):
        short = f"{short:0>8}-0000-1000-8000-00805f9b34fb"
    if len(short) != 36 or set(short) - set("0123456789abcdef-"):
        raise DeviceError(f"{text!r} is not a Bluetooth UUID; write 2a37, or all 36 characters")
    return short


def options(kind: str) -> dict[str, Any]:
    """What bleak's classes are given: the backend of a simulated radio ("client" or "scanner"), or nothing."""
    return {"backend": getattr(simulated[-1], kind)} if simulated else {}


def advertising(scan_s: float) -> list[tuple[Any, Any]]:
    """Every device that advertises: (BLEDevice, AdvertisementData). Raises DeviceError where there is no radio."""
    bleak = library()

    async def look() -> list[tuple[Any, Any]]:
        found = await bleak.BleakScanner.discover(scan_s, return_adv=True, **options("scanner"))
        return list(found.values())

    with asyncio.Runner() as runner:
        found: list[tuple[Any, Any]] = run(runner, look())
    return found


def run(runner: asyncio.Runner, work: Any) -> Any:
    """What a coroutine returns; what fails in the radio is raised as DeviceError."""
    import bleak

    try:
        return runner.run(work)
    except (TimeoutError, bleak.exc.BleakError, OSError, EOFError) as error:
        raise DeviceError(_hint(error)) from None


def wanted(device: str, services: Sequence[str]) -> Callable[[Any, Any], bool]:
    """Whether a device is the one that is meant: by its address, by how its name begins, or by a service that it advertises."""
    needed = {uuid(one) for one in services}

    def fits(found: Any, advertised: Any) -> bool:
        name = advertised.local_name or found.name or ""
        if device:
            return bool(found.address.lower() == device.lower() or name.lower().startswith(device.lower()))
        return bool(needed & {one.lower() for one in advertised.service_uuids})

    return fits


async def seek(device: str, services: Sequence[str], scan_s: float) -> Any:
    """The device that is meant, as soon as it advertises. Raises DeviceError that names those which do."""
    fits, seen = wanted(device, services), dict[str, tuple[Any, Any]]()

    def sees(found: Any, advertised: Any) -> bool:
        seen[found.address] = found, advertised
        return fits(found, advertised)

    found = await library().BleakScanner.find_device_by_filter(sees, timeout=scan_s, **options("scanner"))
    if found is None:
        raise not_found(device, services, scan_s, list(seen.values()))
    return found


def missing(device: str, services: Sequence[str] = ()) -> str:
    """What to report of a device that does not advertise now; "" where it does. Raises DeviceError where bleak is not installed."""
    library()
    with asyncio.Runner() as runner:
        try:
            run(runner, seek(device, services, PROBE_S))
        except DeviceError as error:
            return str(error)
    return ""


def not_found(device: str, services: Sequence[str], scan_s: float, seen: Sequence[tuple[Any, Any]]) -> DeviceError:
    """The error where what is meant does not advertise."""
    names = sorted(
        {f"{advertised.local_name or found.name or 'nameless'} ({found.address})" for found, advertised in seen}
    )
    here = f"; there are {', '.join(names[:SHOWN])}" if names else "; nothing else does either"
    what = repr(device) if device else f"a device with service {' or '.join(services)}"
    return DeviceError(
        f"{what} does not advertise within {scan_s:g} s{here}; is it on (a belt: worn and moist), and not connected to another program?"
    )


def _hint(error: Exception) -> str:
    text = str(error) or type(error).__name__
    if isinstance(error, FileNotFoundError) or "org.bluez" in text or "dbus" in text.lower():
        return f"Bluetooth cannot be used: {text}; is it switched on, and does the system's Bluetooth service run?"
    return f"Bluetooth: {text}"
