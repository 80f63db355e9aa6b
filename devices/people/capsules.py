"""Bodies of capsules before a depth camera: how far away each pixel is, and how much light comes back from it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel(nogil=True)
def render(capsules: Samples, camera: Samples, depth: Samples, light: Samples) -> None:
    """Draw `capsules` (n, 8: two ends in m, radius, brightness) into `depth` (h, w; m) where they are nearer, and their `light` (0 to 1).

    `camera` (4,) is fx, fy, cx, cy in pixels; x to the right, y down, z away from the camera. What faces the camera is brightest.
    """
    h, w = depth.shape
    for i in range(capsules.shape[0]):
        a, b, radius = capsules[i, 0:3], capsules[i, 3:6], capsules[i, 6]
        near = min(a[2], b[2]) - radius
        if near < 0.2:
            continue
        left = min(a[0] / a[2], b[0] / b[2]) - radius / near
        right = max(a[0] / a[2], b[0] / b[2]) + radius / near
        top = min(a[1] / a[2], b[1] / b[2]) - radius / near
        bottom = max(a[1] / a[2], b[1] / b[2]) + radius / near
        for y in range(max(0, int(top * camera[1] + camera[3])), min(h, int(bottom * camera[1] + camera[3]) + 2)):
            for x in range(max(0, int(left * camera[0] + camera[2])), min(w, int(right * camera[0] + camera[2]) + 2)):
                u, v = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
                z, facing = _hit(u, v, a, b, radius)
                if 0.0 < z < depth[y, x]:
                    depth[y, x], light[y, x] = z, capsules[i, 7] * (0.25 + 0.75 * facing)


@kernel
def _hit(u: float, v: float, a: Samples, b: Samples, radius: float) -> tuple[float, float]:
    """Where the ray through (u, v, 1) meets the capsule from `a` to `b`: its z, and the cosine there; 0 where it misses.

    Source: I. Quilez, capsule intersection.
    """
    size = math.sqrt(u * u + v * v + 1.0)
    dx, dy, dz = u / size, v / size, 1.0 / size
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    baba = bx * bx + by * by + bz * bz
    bard = bx * dx + by * dy + bz * dz
    baoa = -(bx * a[0] + by * a[1] + bz * a[2])
    rdoa = -(dx * a[0] + dy * a[1] + dz * a[2])
    oaoa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    k2, k1 = baba - bard * bard, baba * rdoa - baoa * bard
    k0 = baba * oaoa - baoa * baoa - radius * radius * baba
    under = k1 * k1 - k2 * k0
    if under < 0.0:
        return 0.0, 0.0
    t = (-k1 - math.sqrt(under)) / k2 if k2 > 1e-12 else 0.0
    along = baoa + t * bard
    if not 0.0 < along < baba or k2 <= 1e-12:
        end = a if along <= 0.0 else b
        half = -(dx * end[0] + dy * end[1] + dz * end[2])
        under = half * half - (end[0] * end[0] + end[1] * end[1] + end[2] * end[2] - radius * radius)
        if under < 0.0:
            return 0.0, 0.0
        t = -half - math.sqrt(under)
        along = 0.0 if along <= 0.0 else baba
    share = along / baba if baba > 0.0 else 0.0
    nx = (t * dx - a[0] - share * bx) / radius
    ny = (t * dy - a[1] - share * by) / radius
    nz = (t * dz - a[2] - share * bz) / radius
    return t * dz, abs(nx * dx + ny * dy + nz * dz)


def canvas(height: int, width: int, far_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """An empty view: depth far away, no light."""
    return np.full((height, width), far_m), np.zeros((height, width))
