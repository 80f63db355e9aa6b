"""What the tests of body share."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.devices.people.rendered_performer import camera_of
from kinegraph.operators.body.names import LANDMARKS, SEEN
from kinegraph.operators.body.placing import INSIDE
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import grid

WIDTH, HEIGHT, RATE = 160, 120, 30.0
CAMERA = dict(zip(("fx", "fy", "cx", "cy"), camera_of(WIDTH, HEIGHT), strict=True))
DEPTH = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), rate_hz=RATE, units=("mm",), meta={"camera": CAMERA})


def feed(operator: Any, port: str, frames: np.ndarray, start: int = 0) -> dict[str, list[Chunk]]:
    """Frames one by one, from number `start` on; what came out, by output."""
    made: dict[str, list[Chunk]] = {}
    times = grid(RATE, start + len(frames))[start:]
    for time, frame in zip(times.tolist(), frames, strict=True):
        given = operator.process(port, Chunk(np.array([time]), frame[None], time))
        for output, chunk in [("out", given)] if isinstance(given, Chunk) else given:
            made.setdefault(output, []).append(chunk)
    return made


def with_block(frame: np.ndarray, column: int, depth: int, width: int = 14) -> np.ndarray:
    """A frame with somebody in it."""
    frame = frame.copy()
    frame[30:110, column : column + width] = depth
    return frame


def standing(facing: float = -1.0) -> np.ndarray:
    """What a frame shows of somebody 2.5 m away: towards the camera (-1) or away from it (1)."""
    seen = np.zeros(1, SEEN)
    points = seen["points"][0]
    sides = np.array([1.0 if n.startswith("left") else -1.0 if n.startswith("right") else 0.0 for n in LANDMARKS])
    heights = {"shoulder": 0.48, "elbow": 0.2, "wrist": -0.06, "hip": 0.0, "knee": -0.42, "ankle": -0.84}
    y = np.array([-next((h for part, h in heights.items() if part in name), 0.65) for name in LANDMARKS])
    points[:, 5] = -facing * 0.18 * sides
    points[:, 6] = y
    points[:, 0] = 159.5 + 285.6 * points[:, 5] / 2.5
    points[:, 1] = 119.5 + 285.6 * y / 2.5
    points[:, 2] = 2.5 - INSIDE
    points[:, 3:5] = 0.98
    seen["presence"], seen["facing"][0] = 0.99, (0.0, facing * 0.9)
    return seen
