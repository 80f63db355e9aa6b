"""Where cameras hang over beds: at the foot, a side or the head, 1.2 to 2.8 m high, tilted by 0 to 60 degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.sleep.tilted_room import FOCAL, Stay, TiltedCamera, TiltedRoom

SIDES = ("foot", "left", "right", "head")
MIDDLE_M = (0.0, 1.0, 0.5)
"""Of a mattress."""
PLAIN, EMPTY = TiltedCamera(), Stay()
MIN_SEEN = 0.8
"""This much of the mattress is within the picture."""


def placed(where: str, height: float, tilt: float, base: TiltedCamera = PLAIN) -> TiltedCamera:
    """A camera at this side of the bed, `height` m above the floor; it looks at the mattress's middle, `tilt` degrees from the vertical."""
    away = (height - MIDDLE_M[2]) * float(np.tan(np.radians(tilt)))
    if where in ("left", "right"):
        return replace(base, side=away if where == "right" else -away, behind=-1.0, height=height)
    return replace(base, side=0.0, behind=away - 1.0 if where == "foot" else -1.0 - away, height=height)


def random_room(
    seed: int, width: int, height: int, base: TiltedCamera = PLAIN, stay: Stay = EMPTY
) -> tuple[TiltedRoom, str, float, float]:
    """A room, from which side its camera looks, how high it hangs (m), and its tilt: one that sees the bed, and is in no wall."""
    random = np.random.default_rng([seed, 77])
    while True:
        where, high, tilt = str(random.choice(SIDES)), float(random.uniform(1.2, 2.8)), float(random.uniform(0, 60))
        camera = placed(where, high, tilt, base)
        if not -0.25 - 2.0 <= camera.behind <= 0.8 or abs(camera.side) > 1.55:
            continue
        room = TiltedRoom(width, height, camera, stay, seed=seed)
        walled = camera.side < -room.bed[0] / 2 - 0.8 and high < 1.95
        if not walled and _seen(room) >= MIN_SEEN:
            return room, where, high, tilt


def on_mattress(room: TiltedRoom) -> NDArray[np.bool_]:
    """Which pixels (height, width) show the empty mattress."""
    at = room.at + room.empty[..., None] / 1000 * room.rays
    wide, long, high = room.bed
    return (abs(at[..., 0]) < wide / 2) & (at[..., 1] > 0) & (at[..., 1] < long) & (abs(at[..., 2] - high) < 0.03)


def _seen(room: TiltedRoom) -> float:
    """How much of the mattress's area is within the picture."""
    wide, long, high = room.bed
    x, y = np.meshgrid(np.linspace(-wide / 2, wide / 2, 20), np.linspace(0, long, 20))
    towards = np.stack([x, y, np.full_like(x, high)], axis=-1) - room.at
    ahead, right, down = room.axes
    rows, columns = room.empty.shape
    deep = towards @ ahead
    u = towards @ right / deep * FOCAL * columns + columns / 2
    v = towards @ down / deep * FOCAL * columns + rows / 2
    return float(((deep > 0) & (u >= 0) & (u < columns) & (v >= 0) & (v < rows)).mean())
