"""OAK cameras: by USB and in the local network, as depthai finds them. Nothing is opened."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

from kinegraph.devices.discovery.finders import FoundDevice
from kinegraph.devices.oak.library import all_cameras, forbidden, library, permission

YAML = "use: devices.oak.Oak\ndevice: {device}"


def find() -> Iterator[FoundDevice]:
    """Every camera, also those without permission; nothing if depthai is not installed."""
    if find_spec("depthai") is None:
        return
    dai = library()
    for info in all_cameras(dai):
        yield described(dai, info)


def described(dai: Any, info: Any) -> FoundDevice:
    """What a camera's description says of it."""
    device = info.deviceId or info.name
    platform = info.platform.name.removeprefix("X_LINK_")
    state = info.state.name.removeprefix("X_LINK_").lower()
    what = f"Luxonis OAK ({platform}, {'network' if 'TCP' in info.protocol.name else 'USB'} {info.name}, {state})"
    note = permission() if forbidden(dai, info) else "in use by another program" if state == "booted" else ""
    return FoundDevice("oak", device, what, YAML.format(device=f'"{device}"'), note)
