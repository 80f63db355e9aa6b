"""The library depthai: imported when a camera is used, with its telemetry switched off."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import Any

from kinegraph.devices.transport.usb_bus import UsbAddress, rule
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.extras import optional

VENDOR = 0x03E7
"""Intel Movidius: the chip in every OAK with USB."""
QUIET = {
    "DEPTHAI_TELEMETRY": "0",
    "DEPTHAI_DISABLE_STARTUP_NOTIFICATIONS": "1",
    "DEPTHAI_DISABLE_FEEDBACK": "1",
    "DEPTHAI_DISABLE_CRASHDUMP_COLLECTION": "1",
    "DEPTHAI_LEVEL": "error",
}
"""Its own settings: it reports its use to its maker over the Internet by default, which a camera in a bedroom must not."""
NOT_FOUND = "no OAK camera was found; is it connected, with a cable that carries data (USB 3)? `kinegraph devices oak` lists those that are"


def library() -> Any:
    """depthai. What the user's own environment says is left as it is. Raises DeviceError where it is not installed."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    depthai = optional("depthai", "an OAK camera", "pip install 'kinegraph[oak]'", DeviceError)
    if not hasattr(depthai, "Clock") or not hasattr(depthai.Pipeline, "setDeviceStateCallback"):
        raise DeviceError(
            f"depthai {depthai.__version__} is too old for kinegraph: pip install --upgrade 'kinegraph[oak]'"
        )
    return depthai


def all_cameras(dai: Any) -> list[Any]:
    """Every camera that can be seen (depthai's DeviceInfo), those too that may not be used."""
    return list(dai.XLinkConnection.getAllConnectedDevices(dai.XLinkDeviceState.X_LINK_ANY_STATE, False))


def forbidden(dai: Any, info: Any) -> bool:
    """Whether the system denies the use of a camera."""
    return bool(info.status == dai.XLinkError_t.X_LINK_INSUFFICIENT_PERMISSIONS)


def permission() -> str:
    """What to do about that."""
    return f"permission denied; {rule(UsbAddress(VENDOR, None))}"


def missing(seen: Sequence[Any], device: str) -> str:
    """What to say of a camera that is not among those that can be seen; "" where it is."""
    if not seen and not device:
        return NOT_FOUND
    if not device or any(device in (i.deviceId, i.name) for i in seen):
        return ""
    there = ", ".join(i.deviceId or i.name for i in seen) or "no others"
    return f"no OAK camera {device!r} was found (connected: {there}); device is an id, IP address or port"


def not_opened(dai: Any, device: str, error: Exception) -> DeviceError:
    """Why a camera cannot be opened, and what can be done."""
    seen = all_cameras(dai)
    if not_there := missing(seen, device):
        return DeviceError(not_there)
    wanted = [i for i in seen if not device or device in (i.deviceId, i.name)]
    if any(forbidden(dai, info) for info in wanted):
        return DeviceError(f"OAK camera {device or wanted[0].deviceId}: {permission()}")
    return DeviceError(
        f"OAK camera {device or 'that was found first'} cannot be opened: {error}; does another program use it?"
    )


def ns(duration: timedelta) -> int:
    """A time of depthai's in ns; it knows whole microseconds."""
    return (duration.days * 86_400 + duration.seconds) * 1_000_000_000 + duration.microseconds * 1000


def zero_ns(dai: Any, now: Callable[[], int]) -> int:
    """Session time of the moment at which the host clock of depthai stood at 0; the best of some readings."""
    best = width = 1 << 62
    for _ in range(8):
        before, host, after = now(), ns(dai.Clock.now()), now()
        if after - before < width:
            best, width = (before + after) // 2 - host, after - before
    return best
