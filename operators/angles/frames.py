"""Frames of the body's segments from markers, and the angles between them (Wu et al. 2002 and 2005; Grood and Suntay 1983).

Everything is in metres and right-handed, with the laboratory's x forwards, y up and z to the right. So is a segment's frame when somebody
stands upright: rows of a frame (3, 3) are its x, y and z. Places are those of marker_sets.PLACES, by number.
"""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.angles.marker_sets import PLACE, SIDED, TRUNK
from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

LASI, RASI, LPSI, RPSI, SACR, C7, T10, CLAV, STRN = (PLACE[name] for name in TRUNK)
HIP, THI, KNE, KNM, TIB, ANK, ANM, HEE, TOE, SHO, ELB, ELM, WRA, WRB = range(len(SIDED))
FIRST_LEFT, EACH = len(TRUNK), len(SIDED)
PELVIS, THORAX, THIGH, SHANK, FOOT, UPPER_ARM, FOREARM = 0, 1, 2, 4, 6, 8, 10
"""Segments; of those with two sides the left one, the right one is next."""
SEGMENTS = 12


@kernel
def frames_of(p: Samples, knee_m: float, ankle_m: float, elbow_m: float, out: Samples) -> None:
    """Frames of SEGMENTS into `out` (12, 3, 3) from places `p` (37, 3); NaN where markers are missing.

    knee_m, ankle_m, elbow_m: from the outer marker's middle to the joint's middle, where there is no inner marker.
    """
    out[:] = math.nan
    hips = np.full((2, 3), math.nan)
    _pelvis(p, out[PELVIS], hips)
    _thorax(p, out[THORAX], hips)
    for side in range(2):
        outer = 1.0 if side else -1.0
        first = FIRST_LEFT + side * EACH
        axis, knee, ankle, elbow, wrist = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        _hinge(p, first + KNE, first + KNM, first + THI, hips[side], out[PELVIS, 2], knee_m, outer, knee, axis)
        _along(hips[side], knee, axis, out[THIGH + side])
        _hinge(p, first + ANK, first + ANM, first + TIB, knee, axis, ankle_m, outer, ankle, axis)
        _along(knee, ankle, axis, out[SHANK + side])
        _foot(p[first + HEE], p[first + TOE], knee, ankle, axis, out[FOOT + side])
        _hinge(p, first + ELB, first + ELM, -1, p[first + SHO], out[THORAX, 2], elbow_m, outer, elbow, axis)
        _middle(p[first + WRA], p[first + WRB], wrist)
        if p[first + ELM, 0] != p[first + ELM, 0]:
            _bend_axis(p[first + SHO], elbow, wrist, axis)
        _along(p[first + SHO], elbow, axis, out[UPPER_ARM + side])
        _along(elbow, wrist, axis, out[FOREARM + side])


@kernel
def _pelvis(p: Samples, out: Samples, hips: Samples) -> None:
    """By the iliac spines, and the hips' joints by Harrington et al. (2007); by the hips themselves, where these are given:
    under the shoulders, or upright."""
    back, front, z, x, y = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    left_hip, right_hip = p[FIRST_LEFT + HIP], p[FIRST_LEFT + EACH + HIP]
    _middle(p[LPSI], p[RPSI], back)
    if back[0] != back[0]:
        back[:] = p[SACR]
    _middle(p[LASI], p[RASI], front)
    if p[LASI, 0] == p[LASI, 0] and p[RASI, 0] == p[RASI, 0] and back[0] == back[0]:
        wide = _minus(p[RASI], p[LASI], z)
        deep = _minus(front, back, x)
        _orthonormal(z, x, y, out)
        for side in range(2):
            outer = 1.0 if side else -1.0
            for c in range(3):
                hips[side, c] = (
                    front[c]
                    + (-0.24 * deep - 0.0099) * out[0, c]
                    + (-0.30 * wide - 0.0109) * out[1, c]
                    + outer * (0.33 * wide + 0.0073) * out[2, c]
                )
    if left_hip[0] == left_hip[0] and right_hip[0] == right_hip[0]:
        hips[0], hips[1] = left_hip, right_hip
        if out[0, 0] != out[0, 0]:
            shoulders = np.empty(3)
            _middle(p[FIRST_LEFT + SHO], p[FIRST_LEFT + EACH + SHO], shoulders)
            _middle(left_hip, right_hip, back)
            _minus(right_hip, left_hip, z)
            if shoulders[0] == shoulders[0]:
                _minus(shoulders, back, y)
            else:
                y[0], y[1], y[2] = 0.0, 1.0, 0.0
            _cross(y, z, x)
            _orthonormal(z, x, y, out)


@kernel
def _thorax(p: Samples, out: Samples, hips: Samples) -> None:
    """By neck and breastbone before and behind (ISB); by the shoulders over the hips, where these are missing."""
    top, low, x, y, z = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _middle(p[C7], p[CLAV], top)
    _middle(p[T10], p[STRN], low)
    if top[0] == top[0] and low[0] == low[0]:
        _minus(top, low, y)
        forward = np.empty(3)
        _minus(p[CLAV], p[C7], forward)
        _cross(forward, y, z)
        _cross(y, z, x)
    else:
        left, right = p[FIRST_LEFT + SHO], p[FIRST_LEFT + EACH + SHO]
        _middle(left, right, top)
        _middle(hips[0], hips[1], low)
        _minus(top, low, y)
        _minus(right, left, z)
        _cross(y, z, x)
    _cross(x, y, z)
    _along_axes(y, z, out)


@kernel
def _hinge(
    p: Samples,
    lateral: int,
    medial: int,
    wand: int,
    above: Samples,
    usual: Samples,
    half_m: float,
    outer: float,
    joint: Samples,
    axis: Samples,
) -> None:
    """The middle of a knee, ankle or elbow and its axis, to the right: by the inner marker, by a wand above it, or as `usual`."""
    at = p[lateral]
    has_inner = p[medial, 0] == p[medial, 0]
    has_wand = wand >= 0 and p[wand, 0] == p[wand, 0]
    way, normal, long = np.empty(3), np.empty(3), np.empty(3)
    if has_inner:
        _middle(at, p[medial], joint)
        _minus(at, p[medial], way)
    elif half_m == 0.0:
        joint[:] = at
        for c in range(3):
            way[c] = outer * usual[c]
    else:
        _minus(above, at, long)
        if has_wand:  # the joint lies in the plane of the wand, at a right angle to the bone (Davis et al. 1991)
            _minus(p[wand], at, way)
            _cross(long, way, normal)
            _cross(long, normal, way)
            if _dot(way, usual) * outer < 0.0:
                for c in range(3):
                    way[c] = -way[c]
        else:
            for c in range(3):
                way[c] = outer * usual[c]
        reach = math.sqrt(_dot(long, long))
        if not reach > half_m:
            joint[:] = math.nan
            axis[:] = math.nan
            return
        _straighten(way, long)
        tilt = math.asin(half_m / reach)
        for c in range(3):  # at a right angle between the bone and the way to the marker
            joint[c] = at[c] - half_m * (math.cos(tilt) * way[c] - math.sin(tilt) * long[c] / reach)
    size = math.sqrt(_dot(way, way))
    for c in range(3):
        axis[c] = outer * way[c] / size


@kernel
def _bend_axis(shoulder: Samples, elbow: Samples, wrist: Samples, axis: Samples) -> None:
    """The elbow's axis, to the right, by the arm's own bend; left as it is where the arm is straight."""
    upper, fore, normal = np.empty(3), np.empty(3), np.empty(3)
    _minus(shoulder, elbow, upper)
    _minus(wrist, elbow, fore)
    _cross(upper, fore, normal)
    size = math.sqrt(_dot(normal, normal))
    if size > 0.17 * math.sqrt(_dot(upper, upper) * _dot(fore, fore)):
        for c in range(3):
            axis[c] = -normal[c] / size


@kernel
def _foot(heel: Samples, toe: Samples, knee: Samples, ankle: Samples, axis: Samples, out: Samples) -> None:
    """x from heel to toe, z to the right as the ankle's axis."""
    x, y = np.empty(3), np.empty(3)
    if heel[0] == heel[0]:
        _minus(toe, heel, x)
    else:
        _minus(toe, ankle, x)
    _cross(axis, x, y)
    z = np.empty(3)
    _cross(x, y, z)
    for row, v in ((0, x), (1, y), (2, z)):
        size = math.sqrt(_dot(v, v))
        for c in range(3):
            out[row, c] = v[c] / size


@kernel
def _along(top: Samples, low: Samples, axis: Samples, out: Samples) -> None:
    """y from the lower joint to the upper, z as near as it can to `axis`."""
    y = np.empty(3)
    _minus(top, low, y)
    _along_axes(y, axis, out)


@kernel
def _along_axes(y: Samples, axis: Samples, out: Samples) -> None:
    x, z = np.empty(3), np.empty(3)
    _cross(y, axis, x)
    _cross(x, y, z)
    for row, v in ((0, x), (1, y), (2, z)):
        size = math.sqrt(_dot(v, v))
        for c in range(3):
            out[row, c] = v[c] / size if size > 0.0 else math.nan


@kernel
def _orthonormal(z: Samples, x: Samples, y: Samples, out: Samples) -> None:
    """z as it is, x as near as it can."""
    _cross(z, x, y)
    _cross(y, z, x)
    for row, v in ((0, x), (1, y), (2, z)):
        size = math.sqrt(_dot(v, v))
        for c in range(3):
            out[row, c] = v[c] / size if size > 0.0 else math.nan


@kernel
def _straighten(way: Samples, long: Samples) -> None:
    """`way` at a right angle to `long`, of length 1."""
    share = _dot(way, long) / _dot(long, long)
    for c in range(3):
        way[c] -= share * long[c]
    size = math.sqrt(_dot(way, way))
    for c in range(3):
        way[c] /= size


@kernel
def _middle(a: Samples, b: Samples, out: Samples) -> None:
    """Between two places; the one that is there, where the other is not."""
    for c in range(3):
        out[c] = (a[c] + b[c]) / 2.0
        if a[c] != a[c]:
            out[c] = b[c]
        elif b[c] != b[c]:
            out[c] = a[c]


@kernel
def _minus(a: Samples, b: Samples, out: Samples) -> float:
    """a - b into `out`; returns how long that is."""
    total = 0.0
    for c in range(3):
        out[c] = a[c] - b[c]
        total += out[c] * out[c]
    return math.sqrt(total)


@kernel
def _cross(a: Samples, b: Samples, out: Samples) -> None:
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    out[0], out[1], out[2] = x, y, z


@kernel
def _dot(a: Samples, b: Samples) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
