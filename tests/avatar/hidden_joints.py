"""Which joints of the rendered performer a scene hides, by the truth; and scenes with furniture and other people."""

from __future__ import annotations

from unittest import mock

import numpy as np

from kinegraph.devices.people import rendered_performer
from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer, camera_of
from kinegraph.stream.chunk import Array
from kinegraph.stream.domain.humanoid import BONES
from tests.avatar.test_degraded_scenes import AvatarChain, Following, Scene, empty_room

BONE_OF = {
    "shoulder": "UpperArm",
    "elbow": "LowerArm",
    "wrist": "Hand",
    "hip": "UpperLeg",
    "knee": "LowerLeg",
    "ankle": "Foot",
}
FLAGGED_BY = [
    BONES.index("Head" if point == "head" else point.split("_")[0].capitalize() + BONE_OF[point.split("_")[1]])
    for point in POINTS
]
"""Of each of POINTS the bone that is guessed where the point is not seen."""
COVERED_MM, OF_THE_BODY_MM = 100, 250


def hidden(scene: Scene, first: int, last: int, width: int, height: int) -> Array:
    """Which of POINTS (last - first, 13) a scene covers, of 30 frames a second: nine tenths of the body's pixels around the joint."""
    performer, camera = RenderedPerformer(width, height), camera_of(width, height)
    made = np.zeros((last - first, len(POINTS)), np.bool_)
    for k in range(first, last):
        before = performer.frame(k, k / 30.0).astype(int)
        after = scene(k, performer.frame(k, k / 30.0), performer.image(k, k / 30.0))[0].astype(int)
        for i, place in enumerate(performer.joints(k / 30.0)):
            u, v = (round(camera[2 + a] + camera[a] * place[a] / place[2]) for a in range(2))
            near = slice(max(v - 2, 0), v + 3), slice(max(u - 2, 0), u + 3)
            body = np.abs(before[near] - 1000 * place[2]) < OF_THE_BODY_MM
            made[k - first, i] = body.any() and (np.abs(after - before)[near] > COVERED_MM)[body].mean() > 0.9
    return made


def late_flags(reported: Following, covered: Array, first: int) -> dict[str, int]:
    """Joints that are `covered` (n, 13) from frame `first` on, and not flagged for more than 3 frames on end: for how many."""
    found = {}
    for i, point in enumerate(POINTS):
        run = most = 0
        for k, is_covered in enumerate(covered[:, i]):
            run = run + 1 if is_covered and not reported.guessed[first + k, FLAGGED_BY[i]] else 0
            most = max(most, run)
        if most > 3:
            found[point] = most
    return found


def late_returns(reported: Following, covered: Array, first: int) -> dict[str, int]:
    """Joints that have been covered, and are not seen again within 10 frames once nothing covers them any more: after how many."""
    found = {}
    for i, point in enumerate(POINTS):
        if covered[:, i].any():
            seen = np.flatnonzero(
                reported.guessed[first + int(np.flatnonzero(covered[:, i])[-1]) + 1 :, FLAGGED_BY[i]] == 0
            )
            after = int(seen[0]) if len(seen) else len(reported.guessed)
            if after > 10:
                found[point] = after
    return found


def _laid_over(depth: Array, image: Array, away_m: Array, grey: int) -> tuple[Array, Array]:
    """What is `away_m` (h, w) from the camera, inf where nothing is, before what is seen."""
    nearer = 1000 * away_m < np.where(depth == 0, 65535, depth)
    depth, image = depth.copy(), image.copy()
    depth[nearer], image[nearer] = (1000 * away_m[nearer]).astype(np.uint16), grey
    return depth, image


def touching_table(k: int, depth: Array, image: Array) -> tuple[Array, Array]:
    """A table, 80 cm high and 120 wide with a cloth down to the floor, that reaches from 1.3 m before the camera to the person's belly."""
    h, w = depth.shape
    fx, fy, cx, cy = camera_of(w, h)
    row, column = np.mgrid[:h, :w]
    down, across = (row - cy) / fy, (column - cx) / fx
    below, near = rendered_performer.HEIGHT_M - 0.8, 1.3
    top = below / np.maximum(down, 1e-6)
    on_top = (top >= near) & (top <= rendered_performer.AWAY_M - 0.12) & (np.abs(across * top) <= 0.6)
    cloth = (down * near >= below) & (down * near <= rendered_performer.HEIGHT_M) & (np.abs(across * near) <= 0.6)
    return _laid_over(depth, image, np.where(on_top, top, np.where(cloth, near, np.inf)), 120)


def relieved(k: int, depth: Array, image: Array) -> tuple[Array, Array]:
    """The person leaves to the right from frame 135 on while somebody else, 40 cm farther away, in another pose, comes in from the left."""
    h, w = depth.shape
    out, yet = round(0.75 * w * min(1.0, (k - 135) / 20)), round(0.75 * w * max(0.0, 1.0 - (k - 140) / 20))
    bare, dark = empty_room(k, depth)
    with mock.patch.object(rendered_performer, "AWAY_M", rendered_performer.AWAY_M + 0.4):
        other = RenderedPerformer(w, h, seed=1)
        theirs = other.frame(k, k / 30.0 + 1.3), other.image(k, k / 30.0 + 1.3)
    for frames, shift in ((theirs, -yet), ((depth, image), out)):
        to, of = slice(max(shift, 0), w + min(shift, 0)), slice(max(-shift, 0), w - max(shift, 0))
        nearer = (frames[0][:, of] < bare[:, to] - 150) & (frames[0][:, of] > 0)
        bare[:, to][nearer], dark[:, to][nearer] = frames[0][:, of][nearer], frames[1][:, of][nearer]
    return bare, dark


def played(seen: Scene, seconds: float, *, network: bool) -> Following:
    """The chain from the first frame on, with `seen` in the place of the camera; what it is given are frames of the usual room."""
    width, height = (320, 200) if network else (160, 100)
    chain, performer = AvatarChain(width, height, 30.0, network=network), RenderedPerformer(width, height)
    rows = []
    for k in range(round(30 * seconds)):
        depth, image = seen(k, performer.frame(k, k / 30.0), performer.image(k, k / 30.0))
        rows.append(chain.frame(round(k * 1e9 / 30), depth, image))
    return Following(*(np.array(part) for part in zip(*rows, strict=True)))


def leaning(k: int, depth: Array, image: Array) -> tuple[Array, Array]:
    """A cupboard, 1.3 m high, stands at the person's left, who touches it; from 4.5 to 6 s the camera stands elsewhere."""
    h, w = depth.shape
    fx, fy, cx, cy = camera_of(w, h)
    stands = ("HEIGHT_M", "AWAY_M", "WALL_M")
    there = (1.25, 2.4, 3.6) if 135 <= k < 180 else tuple(getattr(rendered_performer, name) for name in stands)
    with mock.patch.multiple(rendered_performer, **dict(zip(stands, there, strict=True))):
        performer = RenderedPerformer(w, h)
        depth, image = performer.frame(k, k / 30.0), performer.image(k, k / 30.0)
        high, away = rendered_performer.HEIGHT_M, rendered_performer.AWAY_M - 0.05
    row, column = np.mgrid[:h, :w]
    across, up = (column - cx) / fx * away, high - (row - cy) / fy * away
    cupboard = (across >= 0.24) & (across <= 0.7) & (up >= 0.0) & (up <= 1.3)
    return _laid_over(depth, image, np.where(cupboard, away, np.inf), 150)
