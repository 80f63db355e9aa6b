"""Somebody at a desk that hides hips and legs, a skinned mesh with real motion: the seated avatar keeps to its limits, legs are flagged."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from bench.body_render import CAMERA, HEIGHT, Studio, studio
from kinegraph.operators.pose.footing import Footing
from kinegraph.stream.chunk import Array
from kinegraph.stream.domain.humanoid import BONES
from tests.avatar import test_degraded_scenes as scenes
from tests.avatar.test_degraded_scenes import AvatarChain, Following, held
from tests.support.pose_model import pose_network_or_skip
from tests.support.real import needs_data

EMPTY, SEEN, DESK_M, FROM_M = 40, 95, 1.15, 2.0
"""Frames of the empty room, and with somebody in it; how high the desk is, above the hips, and how far from the camera."""
SETTLED = EMPTY + 10
HIDDEN = [b for b, bone in enumerate(BONES) if bone.endswith(("UpperLeg", "LowerLeg", "Foot"))]
UPPER = [BONES.index(bone) for bone in ("Head", "LeftUpperArm", "RightUpperArm")]


def frames(room: Studio, sequence: str, first: int) -> Iterator[tuple[Array, Array]]:
    """Depth and infrared: the room with the desk, then somebody behind it."""
    down = (np.arange(HEIGHT) - CAMERA[3]) / CAMERA[1] * FROM_M
    desk = (down >= 1.1 - DESK_M)[:, None] & np.ones_like(room.room, np.bool_)
    clip = room.clip(sequence, first, first + SEEN, 0.0)
    random = np.random.default_rng(4)
    for k in range(EMPTY + SEEN):
        depth = clip.empty[k % len(clip.empty)] if k < EMPTY else clip.depth[k - EMPTY]
        image = np.full(depth.shape, 18, np.uint8) if k < EMPTY else clip.infrared[k - EMPTY]
        noise = random.integers(-4, 5, depth.shape)
        yield np.where(desk, 1000 * FROM_M + noise, depth).astype(np.uint16), np.where(desk, 60, image).astype(np.uint8)


def followed(sequence: str, first: int, *, network: bool) -> Following:
    room = studio(Path(os.environ["KINEGRAPH_DATA"]) / "body", "male")
    with (
        mock.patch.object(scenes, "camera_of", lambda w, h: tuple(CAMERA.tolist())),
        mock.patch.object(scenes, "Footing", partial(Footing, seated=True)),
    ):
        chain = AvatarChain(320, HEIGHT, 30.0, network=network)
    rows = [chain.frame(round(k * 1e9 / 30), *both) for k, both in enumerate(frames(room, sequence, first))]
    return Following(*(np.array(part) for part in zip(*rows, strict=True)))


@needs_data
@pytest.mark.parametrize("network", [False, True], ids=["depth alone", "network"])
def test_somebody_at_a_desk_is_followed_from_the_hips_up(network: bool) -> None:
    if network:
        pose_network_or_skip()
    reported = followed("14_14", 700, network=network)
    held(reported, 30.0)
    later = reported.guessed[SETTLED:]
    assert later[:, HIDDEN].all(), "a hidden leg is not flagged"
    assert later[:, UPPER].mean() < 0.5, "nobody is followed"
    legs = reported.poses[:, 3:].reshape(len(reported.poses), -1, 4)[:, HIDDEN]
    assert np.ptp(legs[SETTLED:], axis=0).max() < 1e-9, "the legs of somebody on a chair move"
