"""A person whom the image's border cuts: joints outside are flagged as guessed within 3 frames, and seen again within 10."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.people.rendered_performer import POINTS
from kinegraph.operators.body.ends import border_of, cut_off, head_cut_off, outside
from tests.avatar.half_out import FIRST, LAST, HalfOut
from tests.avatar.hidden_joints import late_flags, late_returns
from tests.avatar.test_degraded_scenes import held, through
from tests.support.pose_model import pose_network_or_skip

SCENES = [HalfOut(aside=side * share, frames=f) for side in (1, -1) for share in (0.4, 0.45, 0.5) for f in (1, 20)]
SCENES += [HalfOut(away_m=away, frames=20) for away in (2.0, 1.6, 1.2)]


def _hides(scene: HalfOut, *, network: bool) -> None:
    emitted = through(scene, 30.0, network=network)
    held(emitted, 30.0)
    out = scene.outside(*((320, 200) if network else (160, 100)))
    assert out.any(), "the scene hides nothing"
    assert not late_flags(emitted, out, FIRST)
    out[-1] = out.any(axis=0)  # whose hand is at the border while the wrist is in view is back once the trouble is over
    assert not late_returns(emitted, out, FIRST)
    assert not emitted.guessed[LAST + 10 :].all(axis=0).any(), "a bone is never found again"


@pytest.mark.parametrize("scene", SCENES, ids=str)
def test_what_is_outside_is_flagged_by_depth_alone(scene: HalfOut) -> None:
    _hides(scene, network=False)


@pytest.mark.parametrize("scene", [HalfOut(aside=0.45), HalfOut(aside=-0.5, frames=20)], ids=str)
def test_what_is_outside_is_flagged_with_the_network(scene: HalfOut) -> None:
    pose_network_or_skip()
    _hides(scene, network=True)


def test_who_is_seen_but_for_a_forearm_is_followed() -> None:
    scene = HalfOut(aside=-0.45, frames=20)
    emitted, out = through(scene, 30.0, network=False), scene.outside(160, 100)
    assert {POINTS[i] for i in np.flatnonzero(out.any(axis=0))} == {"right_elbow", "right_wrist"}
    assert emitted.guessed[FIRST:LAST].mean() < 0.3, "what can be seen is flagged"


def test_a_shoulder_beside_a_neck_at_the_border_is_no_head() -> None:
    points = np.full((20, 20, 3), np.nan)
    y, x = np.mgrid[:20, :20]
    places = np.stack([0.05 * (x - 10), 0.05 * y, np.full((20, 20), 2.0)], axis=2)
    points[2:12, 5:16] = places[2:12, 5:16]  # a trunk
    points[:2, 9:12] = places[:2, 9:12]  # and a neck that the border cuts
    border = border_of(points)
    assert border.shape == (3, 3) and (border[:, 1] == 0.0).all()
    shoulder, usual = places[2, 15], np.array([0.0, -0.1, 2.0])
    assert head_cut_off(border, shoulder, usual) and not head_cut_off(border, np.array([0.0, -0.05, 2.0]), usual)
    assert cut_off(border, np.stack([places[1, 10], shoulder]), 0.06).tolist() == [True, False]
    assert not cut_off(border[:0], shoulder[None], 0.06).any() and not head_cut_off(border[:0], shoulder, usual)


def test_what_the_image_does_not_show_is_outside() -> None:
    places = np.array([[0.0, 0.0, 2.0], [1.7, 0.0, 2.0], [0.0, -1.3, 2.0], [np.nan] * 3])
    assert outside(places, np.array([60.0, 60.0, 47.5, 35.5]), (72, 96)).tolist() == [False, True, True, False]
