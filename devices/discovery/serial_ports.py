"""Serial ports: what is connected to each, as far as its USB ids tell, and the node that reads it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kinegraph.devices.discovery.finders import FoundDevice
from kinegraph.devices.transport.transport import connected_ports


@dataclass(frozen=True, slots=True)
class KnownAdapter:
    """What an adapter's ids mean. Many devices share an adapter's chip, so it says what it may be."""

    what: str
    yaml: str


CYTON = "use: devices.cyton.Cyton\nport: {port}"
LINES = "use: devices.lines.AsciiLines\nport: {port}\ncolumns: [micros, emg]\ntime: micros"
MTI = "use: devices.mti.Mti\nport: {port}"
DECLARED = "use: devices.frames.Binary\nport: {port}\nframes: ...   # as in configs/witmotion.yaml"

BLUETOOTH = KnownAdapter(
    "a Bluetooth device bound to this port: a BITalino, or a Shimmer3",
    "use: devices.bitalino.Bitalino   # a Shimmer3: devices.shimmer.Shimmer, and no channels\nport: {port}\n"
    "channels: [{{input: A1, sensor: emg}}]",
)
"""What /dev/rfcomm0 and the like may be; the system knows no more of it."""

KNOWN: dict[tuple[int, int | None], KnownAdapter] = {
    (0x0403, 0x6015): KnownAdapter("FTDI FT231X: the dongle of an OpenBCI Cyton has this chip", CYTON),
    (0x0403, 0x6001): KnownAdapter("FTDI FT232R adapter", DECLARED),
    (0x2341, None): KnownAdapter("Arduino", LINES),
    (0x2A03, None): KnownAdapter("Arduino", LINES),
    (0x239A, None): KnownAdapter("Adafruit board", LINES),
    (0x16C0, 0x0483): KnownAdapter("Teensy", LINES),
    (0x303A, None): KnownAdapter("Espressif ESP32", LINES),
    (0x1A86, 0x7523): KnownAdapter("CH340 adapter: WitMotion sensors and many Arduino clones have this chip", DECLARED),
    (0x10C4, 0xEA60): KnownAdapter("CP210x adapter: many sensors and ESP32 boards have this chip", DECLARED),
    (0x2639, None): KnownAdapter("Xsens/Movella MTi", MTI),
}
"""By USB vendor and product; None stands for any product."""


BY_ID = Path("/dev/serial/by-id")
"""Where Linux keeps a name of each adapter by its maker, kind and serial number."""


def lasting_name(device: str) -> str:
    """The port's name that stays the same when adapters change places, where the system has one; else `device`."""
    real = os.path.realpath(device)
    names = sorted(BY_ID.iterdir()) if BY_ID.is_dir() else []
    return next((str(name) for name in names if os.path.realpath(name) == real), device)


def find() -> Iterator[FoundDevice]:
    """Every serial port that is a real one or says what it is."""
    for port in connected_ports():
        if port.device.startswith("/dev/rfcomm"):
            yield FoundDevice(
                "serial", port.device, BLUETOOTH.what, BLUETOOTH.yaml.format(port=port.device), _note(port.device)
            )
            continue
        name = lasting_name(port.device)
        known = KNOWN.get((port.vid or 0, port.pid)) or KNOWN.get((port.vid or 0, None))
        yield FoundDevice(
            "serial",
            name,
            _what(port.description, port.manufacturer, port.serial_number, known),
            (known.yaml if known else LINES).format(port=name),
            _note(port.device),
        )


def _what(description: str | None, manufacturer: str | None, number: str | None, known: KnownAdapter | None) -> str:
    text = ", ".join(
        part for part in (description, manufacturer, number and f"serial number {number}") if part and part != "n/a"
    )
    return f"{known.what} ({text})" if known else text


def _note(device: str) -> str:
    if device.startswith("/dev/") and not os.access(device, os.R_OK | os.W_OK):
        return "no permission: sudo usermod -aG dialout $USER, then log in again"
    return ""
