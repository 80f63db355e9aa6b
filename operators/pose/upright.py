"""Detects that `up` names the wrong axis, from a walking person."""

from __future__ import annotations

import math

import numpy as np
import structlog

from kinegraph.operators.pose.limb_kernel import FOOT, HEAD, HIPS, SIDE
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.kernel import kernel

log = structlog.get_logger(__name__)

STEADY, ALONG, ASIDE = 0.95, 0.94, 0.5
"""The directions from feet to head are one where their mean is this long at least; that lies along an axis by a cosine of the second, and
not along another below the third."""
WALKED_M, LEAST_S, MOST_S = 0.75, 2.0, 10.0
"""Who goes so far across the line from feet to head does not lie. Asked after the second, until the third, of being seen."""
LEAP_M = 0.25
"""A person does not go so far from a sample to the next: what was walked before does not count."""
SEEN, SUM, LOW, HIGH, TOLD, RATE, PLACE = 0, 1, 4, 7, 10, 11, 12
"""Places in a tally (15,): samples; the sum of directions from feet to head; where the hips were, at least and at most;
whether it was reported; the rate in Hz; where the hips are (3,)."""
AXIS_NAMES = ("x", "y", "z")


@kernel
def tally_up(joints: Samples, quality: Samples, tally: Samples) -> None:
    """Add samples of joints (n, 22, 3), of which head, feet and hips are seen by `quality` (n, 22 + more), to a tally (15,)."""
    for i in range(joints.shape[0]):
        if quality[i, HEAD] > 0.0 or quality[i, FOOT] > 0.0 or quality[i, FOOT + SIDE] > 0.0 or quality[i, HIPS] > 0.0:
            continue
        n = 0.0
        for a in range(3):
            n += (joints[i, HEAD, a] - 0.5 * (joints[i, FOOT, a] + joints[i, FOOT + SIDE, a])) ** 2
        if n < 0.01:
            continue
        step = 0.0
        for a in range(3):
            step = max(step, abs(joints[i, HIPS, a] - tally[PLACE + a]))
        first = tally[SEEN] == 0.0 or step > LEAP_M
        for a in range(3):
            way = joints[i, HEAD, a] - 0.5 * (joints[i, FOOT, a] + joints[i, FOOT + SIDE, a])
            tally[SUM + a] += way / math.sqrt(n)
            tally[PLACE + a] = joints[i, HIPS, a]
            tally[LOW + a] = joints[i, HIPS, a] if first else min(tally[LOW + a], joints[i, HIPS, a])
            tally[HIGH + a] = joints[i, HIPS, a] if first else max(tally[HIGH + a], joints[i, HIPS, a])
        tally[SEEN] += 1.0


def lies_along(tally: Samples) -> tuple[int, float] | None:
    """The axis (0 x, 2 z, 1 y turned over), and its sign, along which somebody stands who walks; None if that is y, or may be."""
    mean = tally[SUM : SUM + 3] / max(tally[SEEN], 1.0)
    axis = max(range(3), key=lambda a: abs(float(mean[a])))
    size, sign = float((mean**2).sum()) ** 0.5, math.copysign(1.0, float(mean[axis]))
    if size < STEADY or abs(mean[axis]) < ALONG or mean[1] > ASIDE:
        return None
    walked = tally[HIGH : HIGH + 3] - tally[LOW : LOW + 3]
    across = max(float(walked[a]) for a in range(3) if a != axis)
    return (axis, sign) if across >= WALKED_M or (axis == 1 and sign < 0) else None


def advice(axis: int, sign: float, valid: tuple[str, ...]) -> tuple[str, str]:
    """The name of a signed axis, and what to do about it, where `up` may be one of the `valid`."""
    name = ("-" if sign < 0 else "") + AXIS_NAMES[axis]
    return name, f"set `up: {name}`" if name in valid else "turn the markers: y or z must point up"


def upright_along(tree: JointTree, poses: Samples, rate_hz: float) -> str:
    """The axis along which the humanoid of `poses` (n, 91) stands in its first seconds, if it walks and that is not y; "" otherwise."""
    tally = np.zeros(15)
    joints = joints_of(tree, poses[: round(MOST_S * rate_hz)])[1]
    tally_up(joints, np.zeros((len(joints), len(BONES))), tally)
    found = lies_along(tally) if tally[SEEN] >= LEAST_S * rate_hz else None
    return advice(*found, ())[0] if found else ""


def warn(tally: Samples, axes: Times, signs: Samples, up: str) -> bool:
    """Warn if a person stands along another axis of the input than `up`; returns whether it warned."""
    found = lies_along(tally)
    if found is None:
        return False
    axis, sign = found
    name, cure = advice(int(axes[axis]), sign * float(signs[axis]), ("y", "z", "-y"))
    log.warning(f"somebody walks upright along {name} of the markers, but `up` is {up}: {cure}", operator="WholePose")
    return True
