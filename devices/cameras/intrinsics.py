"""What a depth camera's stream says of its lens: a pinhole's focal lengths and centre, given or about what such cameras have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stream.errors import ParameterError


def lens(intrinsics: Sequence[float], width: int, height: int, usual_focal: float) -> dict[str, Any]:
    """fx, fy, cx, cy in pixels, and whether they are known; `usual_focal`: of such cameras, as a share of the width.

    Raises ParameterError.
    """
    if len(intrinsics) not in (0, 4):
        raise ParameterError("intrinsics", list(intrinsics), "four numbers, fx, fy, cx, cy, or left out")
    usual = (usual_focal * width, usual_focal * width, (width - 1) / 2, (height - 1) / 2)
    return {**dict(zip(("fx", "fy", "cx", "cy"), intrinsics or usual, strict=True)), "known": bool(intrinsics)}
