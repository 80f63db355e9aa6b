"""Features of frames for motion matching, the way ahead in the same numbers, and the offset of a transition that decays (Clavet 2016)."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.domain.skeleton import multiply
from kinegraph.stream.kernel import kernel

TRACK = 10
"""Numbers that are kept of a frame: the root's place, its heading, both ankles."""
FEATURES = 27
"""Place and facing 1/3, 2/3 and 1 s later; ankles and their velocities; the root's velocity."""
PLACE, FACING, ANKLE, ANKLE_SPEED, ROOT_SPEED = 2.0, 3.0, 3.75, 1.0, 1.7
"""Weight over usual spread of each kind of feature (m, unit vector, m, m/s, m/s): weights of Holden et al. 2020, spreads of walks."""
MIN_FRAMES = 3
"""A transition leads at least this many frames away."""
TURN_AT_M = 0.25
"""A point of the path that is nearer than this does not say where to face."""


@kernel
def heading_of(pose: Samples) -> float:
    """The root's turn about y, rad."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    return math.atan2(2.0 * (w * y + x * z), 1.0 - 2.0 * (x * x + y * y))


@kernel
def track_all(poses: Samples, joints: Samples, ankles: Times, out: Samples) -> None:
    """What is kept of poses (n, w) with joints (n, j, 3), of which `ankles` (2,) are the left and the right one, into `out` (n, TRACK)."""
    for i in range(poses.shape[0]):
        for a in range(3):
            out[i, a] = poses[i, a]
            out[i, 4 + a], out[i, 7 + a] = joints[i, ankles[0], a], joints[i, ankles[1], a]
        out[i, 3] = heading_of(poses[i])


@kernel
def describe(tracks: Samples, at: int, last: int, rate_hz: float, out: Samples) -> None:
    """Features of frame `at` into `out` (FEATURES,); `last` is the take's last frame, after which it continues as it moved there.

    tracks (n, TRACK) is a ring: frames are numbered on, and found modulo n. The frame before `at`, and before `last`, must be of the take.
    """
    n = tracks.shape[0]
    here, before = tracks[at % n], tracks[(at - 1) % n]
    cos, sin = math.cos(here[3]), math.sin(here[3])
    end, close = tracks[last % n], tracks[(last - 1) % n]
    for k in range(3):
        later = at + round(rate_hz * (k + 1) / 3.0)
        over = max(0, later - last)
        there = tracks[min(later, last) % n]
        x = there[0] + over * (end[0] - close[0]) - here[0]
        z = there[2] + over * (end[2] - close[2]) - here[2]
        turned = there[3] - here[3]
        out[2 * k], out[2 * k + 1] = PLACE * (x * cos - z * sin), PLACE * (z * cos + x * sin)
        out[6 + 2 * k], out[7 + 2 * k] = FACING * math.sin(turned), FACING * math.cos(turned)
    for side in range(2):
        a = 4 + 3 * side
        x, z = here[a] - here[0], here[a + 2] - here[2]
        out[12 + 3 * side], out[14 + 3 * side] = ANKLE * (x * cos - z * sin), ANKLE * (z * cos + x * sin)
        out[13 + 3 * side] = ANKLE * here[a + 1]
        x, z = rate_hz * (here[a] - before[a]), rate_hz * (here[a + 2] - before[a + 2])
        out[18 + 3 * side], out[20 + 3 * side] = ANKLE_SPEED * (x * cos - z * sin), ANKLE_SPEED * (z * cos + x * sin)
        out[19 + 3 * side] = ANKLE_SPEED * rate_hz * (here[a + 1] - before[a + 1])
    x, z = rate_hz * (here[0] - before[0]), rate_hz * (here[2] - before[2])
    out[24], out[26] = ROOT_SPEED * (x * cos - z * sin), ROOT_SPEED * (z * cos + x * sin)
    out[25] = ROOT_SPEED * rate_hz * (here[1] - before[1])


@kernel
def describe_all(tracks: Samples, lasts: Times, first: int, rate_hz: float, played_s: float, out: Samples) -> None:
    """Features of frames from `first` on into `out` (m, FEATURES), NaN where one cannot be entered; `lasts` (n,) as in `PlayedMotion`."""
    n = tracks.shape[0]
    for i in range(out.shape[0]):
        at = first + i
        last = lasts[at % n]
        if at >= 2 and lasts[(at - 2) % n] == last and last - at >= played_s * rate_hz:
            describe(tracks, at, last, rate_hz, out[i])
        else:
            out[i] = np.nan


@kernel
def unlike(p: Samples, q: Samples) -> float:
    """The squared distance of two rows."""
    total = 0.0
    for k in range(p.shape[0]):
        total += (p[k] - q[k]) ** 2
    return total


@kernel
def nearest_ahead(
    path: Samples, length: Samples, along: float, reach: float, x: float, z: float
) -> tuple[float, float]:
    """The point of a polyline (p, 2), `length` (p,) from its start, nearest to (x, z), from `along` on and `reach` further at most:
    how far along it is, and its distance."""
    best, found = math.inf, along
    for i in range(path.shape[0] - 1):
        if length[i + 1] < along or length[i] > along + reach:
            continue
        a, b = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        size = length[i + 1] - length[i]
        share = ((x - path[i, 0]) * a + (z - path[i, 1]) * b) / (size * size) if size > 0.0 else 0.0
        least, most = (
            (along - length[i]) / size if size > 0.0 else 0.0,
            (along + reach - length[i]) / size if size > 0.0 else 1.0,
        )
        share = min(max(share, max(least, 0.0)), min(most, 1.0))
        d = math.sqrt((x - path[i, 0] - share * a) ** 2 + (z - path[i, 1] - share * b) ** 2)
        if d < best:
            best, found = d, length[i] + share * size
    return found, best


@kernel
def point_at(path: Samples, length: Samples, at: float) -> tuple[float, float]:
    """x and z of the point of a polyline that lies `at` from its start."""
    i = 0
    while i < path.shape[0] - 2 and length[i + 1] < at:
        i += 1
    size = length[i + 1] - length[i]
    share = min(1.0, (at - length[i]) / size) if size > 0.0 else 1.0
    return path[i, 0] + share * (path[i + 1, 0] - path[i, 0]), path[i, 1] + share * (path[i + 1, 1] - path[i, 1])


@kernel
def wish(path: Samples, length: Samples, along: float, speed: float, pose: Samples, out: Samples) -> None:
    """Where one should be, and face, 1/3, 2/3 and 1 s later, as the first 12 features: `along` the path, at `speed` (m/s).

    pose (w,)  as it is
    """
    heading = heading_of(pose)
    cos, sin = math.cos(heading), math.sin(heading)
    face_x, face_z = sin, cos
    for k in range(3):
        step = speed * (k + 1) / 3.0
        to_x, to_z = point_at(path, length, along + step)
        x, z = to_x - pose[0], to_z - pose[2]
        far = math.sqrt(x * x + z * z)
        if far > TURN_AT_M:
            face_x, face_z = x / far, z / far
        share = min(1.0, step / far) if far > 0.0 else 0.0
        x, z = share * x, share * z
        out[2 * k], out[2 * k + 1] = PLACE * (x * cos - z * sin), PLACE * (z * cos + x * sin)
        out[6 + 2 * k], out[7 + 2 * k] = FACING * (face_x * cos - face_z * sin), FACING * (face_z * cos + face_x * sin)


@kernel
def apart(p: Samples, q: Samples, out: Samples, work: Samples) -> None:
    """By how much pose `p` (3 + 4 j,) differs from `q`, into `out` (1 + j, 3): the root's place, and a rotation vector for each joint."""
    for a in range(3):
        out[0, a] = p[a] - q[a]
    for j in range(out.shape[0] - 1):
        k = 3 + 4 * j
        work[0, 0], work[0, 1], work[0, 2], work[0, 3] = q[k], -q[k + 1], -q[k + 2], -q[k + 3]
        multiply(p[k : k + 4], work[0], work[1])
        size = math.sqrt(work[1, 1] ** 2 + work[1, 2] ** 2 + work[1, 3] ** 2)
        angle = 2.0 * math.atan2(size, abs(work[1, 0]))
        sign = -1.0 if work[1, 0] < 0.0 else 1.0
        for a in range(3):
            out[1 + j, a] = sign * work[1, 1 + a] * angle / size if size > 1e-9 else 0.0


@kernel
def begin_offset(shown: Samples, new: Samples, off: Samples, speed: Samples, work: Samples) -> None:
    """The offset (1 + j, 3) of the last pose shown to the new one, and its change a frame; `shown`, `new` (2, w): the last two of each."""
    apart(shown[0], new[0], speed, work)
    apart(shown[1], new[1], off, work)
    for j in range(off.shape[0]):
        for a in range(3):
            speed[j, a] = off[j, a] - speed[j, a]


@kernel
def add_offset(pose: Samples, off: Samples, speed: Samples, half_life: float, work: Samples) -> None:
    """Let the offset decay by one frame, as a critically damped spring does, and add it to the pose. half_life: in frames."""
    y = 2.0 * math.log(2.0) / half_life
    left = math.exp(-y)
    for j in range(off.shape[0]):
        size = 0.0
        for a in range(3):
            toward = speed[j, a] + off[j, a] * y
            off[j, a] = left * (off[j, a] + toward)
            speed[j, a] = left * (speed[j, a] - toward * y)
            size += off[j, a] ** 2
        if j == 0:
            for a in range(3):
                pose[a] += off[0, a]
            continue
        size = math.sqrt(size)
        if size < 1e-9:
            continue
        half = 0.5 * size
        work[0, 0] = math.cos(half)
        for a in range(3):
            work[0, 1 + a] = math.sin(half) * off[j, a] / size
        k = 3 + 4 * (j - 1)
        multiply(work[0], pose[k : k + 4], pose[k : k + 4])


def room_for_offset(joints: int) -> tuple[Samples, Samples, Samples]:
    """`off`, `speed` and `work`."""
    return np.zeros((1 + joints, 3)), np.zeros((1 + joints, 3)), np.zeros((2, 4))
