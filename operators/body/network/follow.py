"""Where to look for a person in the next frame, from the landmarks of this one."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Samples

AROUND = 1.25
"""How much larger than the person the square is that the network looks at."""
TRACKED = 0.5
"""From this presence on the next square is taken from the landmarks: it is turned with the trunk."""


def followed(points: Samples, square: Samples) -> tuple[float, float, float, float]:
    """The next square: x, y, side (pixels), turn (rad): around the middle of the hips (point 33), the trunk (to point 34) upright.

    points  (39, 5)  in pixels of the network's picture, which `square` (4,) was
    """
    scale, turn, middle = square[2] / 256, square[3], 128.0
    across, down = (points[33:35, 0] - middle) * scale, (points[33:35, 1] - middle) * scale
    x = square[0] + across * math.cos(turn) - down * math.sin(turn)
    y = square[1] + across * math.sin(turn) + down * math.cos(turn)
    side = 2 * AROUND * math.hypot(x[1] - x[0], y[1] - y[0])
    return float(x[0]), float(y[0]), side, math.pi / 2 - math.atan2(y[0] - y[1], x[1] - x[0])
