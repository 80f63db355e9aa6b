"""Bluetooth LE devices that advertise, and the node that reads each. Nothing is connected to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.util import find_spec

from kinegraph.devices.discovery.finders import FoundDevice
from kinegraph.devices.dot import protocol as movella_dot
from kinegraph.devices.fitness_treadmill import protocol as ftms
from kinegraph.devices.ganglion import protocol as ganglion
from kinegraph.devices.heart_rate import protocol as heart_rate
from kinegraph.devices.transport.ble_radio import advertising, uuid
from kinegraph.stream.errors import DeviceError

SCAN_S = 4.0
NAMES: tuple[tuple[str, str, str], ...] = (
    ("Polar", "Polar sensor", "use: devices.polar.Polar"),
    *((name, "Movella DOT", "use: devices.dot.MovellaDot") for name in movella_dot.NAMES),
    ("Ganglion", "OpenBCI Ganglion", "use: devices.ganglion.Ganglion"),
    ("Simblee", "OpenBCI Ganglion", "use: devices.ganglion.Ganglion"),
)
WIT = "use: devices.frames.Binary\nport: {port}\nframes: ...   # as in configs/witmotion_ble.yaml"
"""By how a name begins: what it is, and the node."""
SERVICES: tuple[tuple[str, str, str], ...] = (
    (ftms.SERVICE, "a fitness machine; if it is a treadmill:", "use: devices.fitness_treadmill.FtmsTreadmill"),
    (ganglion.SERVICE, "OpenBCI Ganglion", "use: devices.ganglion.Ganglion"),
    (heart_rate.SERVICE, "a heart rate sensor", "use: devices.heart_rate.HeartRate"),
)


def find() -> Iterator[FoundDevice]:
    """Every device that advertises its name within four seconds, or is of a known kind; nothing if bleak is not installed."""
    if find_spec("bleak") is None:
        return
    try:
        around = advertising(SCAN_S)
    except DeviceError:
        return  # no radio, or it is switched off
    for device, advertised in around:
        name = advertised.local_name or device.name or ""
        what, yaml = _known(name, advertised.service_uuids)
        if name or yaml:
            where = name or device.address
            node = f'{yaml}\ndevice: "{where}"' if yaml else ""
            if name.startswith("WT"):
                what, node = "WitMotion sensor", WIT.format(port=f"ble://{name}/NOTIFY/WRITE")
            yield FoundDevice("ble", device.address, f"{name or 'nameless'}: {what}", node, f"{advertised.rssi} dBm")


def _known(name: str, services: Sequence[str]) -> tuple[str, str]:
    for begins, what, yaml in NAMES:
        if name.startswith(begins):
            return what, yaml
    offered = {one.lower() for one in services}
    for service, what, yaml in SERVICES:
        if uuid(service) in offered:
            return what, yaml
    return "a Bluetooth LE device", ""
