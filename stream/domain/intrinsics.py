"""What a depth camera's stream says of its lens: a pinhole's focal lengths and centre, given or about what such cameras have.

An image shows what the depth shows, pixel by pixel: seen from the depth's place, it is turned by nothing and moved by nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kinegraph.stream.errors import ParameterError

DISTORTIONS = (4, 5, 8)
"""How many coefficients OpenCV takes: k1, k2, p1, p2, then k3, then k4, k5, k6."""


def lens(
    intrinsics: Sequence[float],
    width: int,
    height: int,
    usual_focal: float,
    distortion: Sequence[float] | None = (0.0, 0.0, 0.0, 0.0, 0.0),
) -> dict[str, Any]:
    """The lens as a stream's spec says it:

    fx, fy, cx, cy  in pixels; `known`: given, not only usual. `usual_focal`: of such cameras, as a share of the width
    distortion      coefficients in OpenCV's order, zeros where the image is free of it; None: not known
    extrinsics      `rotation` (3, 3) and `translation` (3,) in m, from the depth's camera to this stream's: they are one

    Raises ParameterError.
    """
    if len(intrinsics) not in (0, 4):
        raise ParameterError("intrinsics", list(intrinsics), "four numbers, fx, fy, cx, cy, or left out")
    usual = (usual_focal * width, usual_focal * width, (width - 1) / 2, (height - 1) / 2)
    if distortion is not None and len(distortion) not in DISTORTIONS:
        raise ParameterError("distortion", list(distortion), "4, 5 or 8 numbers, k1, k2, p1, p2 and so on, or left out")
    return {
        **dict(zip(("fx", "fy", "cx", "cy"), intrinsics or usual, strict=True)),
        "known": bool(intrinsics),
        "distortion": None if distortion is None else [float(k) for k in distortion],
        "extrinsics": {
            "rotation": [[float(i == j) for j in range(3)] for i in range(3)],
            "translation": [0.0, 0.0, 0.0],
        },
    }
