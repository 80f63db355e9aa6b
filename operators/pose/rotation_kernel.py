"""Small rotations in compiled code: from directions to quaternions (w, x, y, z), and between them."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.skeleton import multiply, turn
from kinegraph.stream.kernel import kernel

TINY = 1e-9


@kernel
def unit(v: Samples) -> float:
    """Make `v` (3,) one long; returns how long it was. One of no length stays as it is."""
    n = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if n > TINY:
        v[0] /= n
        v[1] /= n
        v[2] /= n
    return n


@kernel
def cross(a: Samples, b: Samples, out: Samples) -> None:
    """a x b into `out` (3,), another array."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a: Samples, b: Samples) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@kernel
def shortest(a: Samples, b: Samples, out: Samples) -> None:
    """The shortest rotation from the direction of `a` to that of `b` into `out` (4,); identity if one is zero or they are opposite."""
    n = math.sqrt(dot(a, a) * dot(b, b))
    w = n + dot(a, b)
    if n < TINY or w < 1e-6 * n:
        out[0], out[1], out[2], out[3] = 1.0, 0.0, 0.0, 0.0
        return
    out[0] = w
    out[1] = a[1] * b[2] - a[2] * b[1]
    out[2] = a[2] * b[0] - a[0] * b[2]
    out[3] = a[0] * b[1] - a[1] * b[0]
    normalise(out)


@kernel
def normalise(q: Samples) -> None:
    """Make the quaternion `q` (4,) a unit one; one of no length becomes no rotation."""
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if n > TINY:
        for a in range(4):
            q[a] /= n
    else:
        q[0], q[1], q[2], q[3] = 1.0, 0.0, 0.0, 0.0


@kernel
def from_axes(x: Samples, y: Samples, out: Samples) -> None:
    """The rotation that takes the x axis to `x` and the y axis into the plane of `x` and `y`, into `out` (4,)."""
    ax, ay, az = x[0], x[1], x[2]
    n = math.sqrt(ax * ax + ay * ay + az * az)
    if n < TINY:
        out[0], out[1], out[2], out[3] = 1.0, 0.0, 0.0, 0.0
        return
    ax, ay, az = ax / n, ay / n, az / n
    d = ax * y[0] + ay * y[1] + az * y[2]
    bx, by, bz = y[0] - d * ax, y[1] - d * ay, y[2] - d * az
    n = math.sqrt(bx * bx + by * by + bz * bz)
    if n < TINY:
        out[0], out[1], out[2], out[3] = 1.0, 0.0, 0.0, 0.0
        return
    bx, by, bz = bx / n, by / n, bz / n
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    from_matrix(ax, bx, cx, ay, by, cy, az, bz, cz, out)


@kernel
def from_matrix(
    a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, i: float, out: Samples
) -> None:
    """The rotation matrix [[a, b, c], [d, e, f], [g, h, i]] as a quaternion into `out` (4,)."""
    trace = a + e + i
    if trace > 0.0:
        out[0], out[1], out[2], out[3] = 1.0 + trace, h - f, c - g, d - b
    elif a >= e and a >= i:
        out[0], out[1], out[2], out[3] = h - f, 1.0 + a - e - i, b + d, c + g
    elif e >= i:
        out[0], out[1], out[2], out[3] = c - g, b + d, 1.0 - a + e - i, f + h
    else:
        out[0], out[1], out[2], out[3] = d - b, c + g, f + h, 1.0 - a - e + i
    normalise(out)


@kernel
def from_six(six: Samples, out: Samples) -> None:
    """Two columns of a rotation matrix (6,), not quite at right angles, as the quaternion of the nearest one (Zhou 2019)."""
    from_axes(six[:3], six[3:6], out)


@kernel
def part_way(p: Samples, q: Samples, share: float, out: Samples) -> None:
    """The rotation `share` of the shortest way from `p` to `q` into `out` (4,), which may be either."""
    c = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    sign = 1.0
    if c < 0.0:
        c, sign = -c, -1.0
    a, b = 1.0 - share, share
    if c < 0.9999:
        angle = math.acos(c)
        s = math.sin(angle)
        a, b = math.sin((1.0 - share) * angle) / s, math.sin(share * angle) / s
    for k in range(4):
        out[k] = a * p[k] + sign * b * q[k]
    normalise(out)


@kernel
def angle_between(p: Samples, q: Samples) -> float:
    """By what angle (rad) the rotations `p` and `q` differ."""
    c = abs(p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3])
    return 2.0 * math.acos(min(1.0, c))


@kernel
def relative(p: Samples, q: Samples, out: Samples) -> None:
    """p^-1 q into `out` (4,), another array: `q` as seen from `p`."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    x = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    y = p[0] * q[2] + p[1] * q[3] - p[2] * q[0] - p[3] * q[1]
    z = p[0] * q[3] - p[1] * q[2] + p[2] * q[1] - p[3] * q[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@kernel
def swing(q: Samples, along: Samples, towards: Samples, work: Samples) -> None:
    """Turn `q` (4,) by the shortest way so that it takes `along` (3,) into the direction `towards` (3,). `work` (2, 4)."""
    turn(q, along, work[0, :3])
    shortest(work[0, :3], towards, work[1])
    multiply(work[1], q, q)
    normalise(q)


@kernel
def turn_by(q: Samples, rotation: Samples, factor: float, out: Samples, work: Samples) -> None:
    """`q` (4,) turned by `factor` times the rotation vector `rotation` (3,) in its own axes, into `out` (4,), which may be `q`.

    `work` (4,) is room, of which `rotation` may be the last three.
    """
    angle = factor * math.sqrt(dot(rotation, rotation))
    share = factor * (math.sin(0.5 * angle) / angle if abs(angle) > TINY else 0.5)
    for a in range(3):
        work[1 + a] = share * rotation[a]
    work[0] = math.cos(0.5 * angle)
    multiply(q, work, out)
    normalise(out)
