"""Joints that a scene hides are flagged as guessed within 3 frames, and seen again within 10, joint by joint by the truth; and scenes with
furniture and other people."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.stream.domain.humanoid import BONES
from tests.avatar.hidden_joints import hidden, late_flags, late_returns, leaning, played, relieved, touching_table
from tests.avatar.test_degraded_scenes import Scene, chair, crossing, gone, half, held, invalid, through
from tests.support.pose_model import pose_network_or_skip

FIRST, LAST = 135, 180
"""The frames with the trouble."""
CHAINS = pytest.mark.parametrize("network", [False, True], ids=["depth alone", "network"])


@CHAINS
@pytest.mark.parametrize("scene", [gone, invalid, half, chair, crossing, touching_table])
def test_hidden_joints_are_flagged_and_come_back(scene: Scene, network: bool) -> None:
    if network:
        pose_network_or_skip()
    emitted = through(scene, 30.0, network=network)
    held(emitted, 30.0)
    covered = hidden(scene, FIRST, LAST, *((320, 200) if network else (160, 100)))
    assert covered.any(axis=0).sum() >= 4, "the scene hides nothing"
    assert not late_flags(emitted, covered, FIRST)
    assert not late_returns(emitted, covered, FIRST)


@CHAINS
def test_who_comes_in_while_another_leaves_is_followed_in_their_place(network: bool) -> None:
    if network:
        pose_network_or_skip()
    emitted = through(relieved, 30.0, network=network)
    held(emitted, 30.0)
    guessed = emitted.guessed[FIRST:LAST].sum(axis=1)
    assert guessed.max() == len(BONES), "who has left is not flagged"
    away = -emitted.joints[FIRST:LAST, BONES.index("Head"), 2]
    there = np.flatnonzero(guessed < 8)
    assert ((abs(away[there] - 2.7) < 0.15) | (abs(away[there] - 3.1) < 0.15)).all(), (
        "somebody between the two is invented"
    )
    settled = guessed[25 + 10 :]  # wholly in view from the 25th frame on
    assert settled.max() <= 8 and (abs(away[-8:] - 3.1) < 0.15).all(), "who came in is not followed within 10 frames"


@CHAINS
def test_who_leans_on_a_cupboard_while_the_camera_is_moved_is_not_invented(network: bool) -> None:
    if network:
        pose_network_or_skip()
    emitted = played(leaning, 7.0, network=network)
    held(emitted, 30.0)
    assert emitted.guessed[FIRST + 3 : LAST].sum(axis=1).min() >= 15, "not flagged"
    assert not emitted.guessed[LAST + 10 :].all(axis=0).any(), "not found again"
