"""What people see of an avatar: it is still while they are, nothing leaps, the head is level, left stays left."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.body.extrema import ARMS, LEGS, Extrema
from kinegraph.operators.body.marker_fusion import Surer
from kinegraph.operators.body.names import MARKERS
from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.operators.filters.predict import Predict
from kinegraph.operators.pose.landmarks import USUAL
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.operator import grid
from tests.avatar.test_camera_avatar import camera_spec, someone
from tests.avatar.test_whole_pose import POSES, RATE, TREE, marks, played

FACE = (*USUAL, "nose", "ear_l", "ear_r")


def turned_by(turns: Samples) -> Samples:
    """Degrees by which each rotation (n, 22, 4) turns from one frame to the next."""
    return 2 * np.degrees(np.arccos(np.clip(np.abs((turns[1:] * turns[:-1]).sum(-1)), 0.0, 1.0)))


def shown(x: Samples, names: tuple[str, ...]) -> Samples:
    """World rotations (n, 22, 4) of markers as configs/parts/avatar.yaml smooths and poses them."""
    smooth = OneEuro(cutoff_hz=1.0, beta=10.0)(x.reshape(len(x), -1), rate_hz=RATE)
    return joints_of(TREE, played(smooth, names, follow_hz=1.65)[0])[0]


@pytest.mark.parametrize("bent_rad", [0.0, 0.4])
@pytest.mark.parametrize("names", [USUAL, FACE])
def test_who_stands_still_is_still_under_noise(names: tuple[str, ...], bent_rad: float) -> None:
    """The twist of a nearly straight limb, and how far it bends, come from a joint that lies within its own noise."""
    still = np.repeat(POSES[:1], 240, axis=0)
    if not bent_rad:
        still[:, 3:] = np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))
    x = marks(names, still) + np.random.default_rng(3).normal(0.0, 0.005, (len(still), len(names), 3))
    turned = turned_by(shown(x, names)[60:])
    assert turned.mean(axis=0).max() < 0.5
    assert np.percentile(turned, 95, axis=0).max() < 1.5


@pytest.mark.parametrize("seconds", [0.2, 0.4])
def test_an_arm_that_is_raised_is_followed_in_time_and_never_thrown_beyond(seconds: float) -> None:
    raised = np.repeat(POSES[:1], 120, axis=0)
    at, arm = 3 + 4 * BONES.index("LeftUpperArm"), BONES.index("LeftUpperArm")
    u = np.clip((np.arange(120) / RATE - 2.0) / seconds, 0.0, 1.0)
    angle = -1.3 + 1.3 * (10 * u**3 - 15 * u**4 + 6 * u**5)
    raised[:, at], raised[:, at + 3] = np.cos(angle / 2), np.sin(angle / 2)
    turns = shown(marks(USUAL, raised), USUAL)[:, arm]
    true = joints_of(TREE, raised)[0][:, arm]
    made, wanted = (2 * np.arccos(np.clip(np.abs(q @ true[0]), 0.0, 1.0)) for q in (turns, true))
    assert made[60:].max() < 1.1 * 1.3, "it overshoots by less than a tenth"
    assert np.argmax(made[60:] > 0.65) - np.argmax(wanted[60:] > 0.65) <= 2, "half of the way, in frames"


def test_an_arm_that_waves_is_less_than_a_frame_behind() -> None:
    waves, time = np.repeat(POSES[:1], 240, axis=0), np.arange(240) / RATE
    at, arm = 3 + 4 * BONES.index("LeftUpperArm"), BONES.index("LeftUpperArm")
    angle = -0.8 + 0.5 * np.sin(2 * np.pi * 0.8 * np.maximum(time - 2.0, 0.0))
    waves[:, at], waves[:, at + 3] = np.cos(angle / 2), np.sin(angle / 2)
    x = marks(USUAL, waves) + np.random.default_rng(3).normal(0.0, 0.005, (240, len(USUAL), 3))
    q = shown(x, USUAL)[90:, arm]
    made, speed = 2 * np.arctan2(q[:, 3], q[:, 0]), np.gradient(angle, 1 / RATE)[90:]
    lag_s = ((angle[90:] - made) * speed).sum() / (speed**2).sum()
    assert 0.0 < lag_s < 1 / RATE


def test_a_marker_that_is_seen_again_is_gone_to_by_degrees() -> None:
    x = marks()
    hidden = slice(90, 115)
    x[hidden, [USUAL.index("wrist_l"), USUAL.index("elbow_l")]] = np.nan
    x[115:, USUAL.index("wrist_l")] += [0.2, 0.25, 0.1]
    turns = joints_of(TREE, played(x)[0])[0]
    arm = turned_by(turns)[:, [BONES.index("LeftUpperArm"), BONES.index("LeftLowerArm")]]
    assert np.abs(np.diff(arm[110:130], axis=0)).max() < np.degrees(2 * 80.0 / RATE**2), "faster than limbs turn"


def test_a_bone_that_is_seen_again_is_not_thrown_to_where_it_is() -> None:
    x = marks(USUAL, np.repeat(POSES[:1], 150, axis=0))
    x[70:100, [USUAL.index("wrist_l"), USUAL.index("elbow_l")]] = np.nan
    x[100:, USUAL.index("wrist_l")] += [0.1, 0.25, 0.1]
    x[100:, USUAL.index("elbow_l")] += [0.05, 0.15, 0.0]
    arm = turned_by(shown(x, USUAL))[:, BONES.index("LeftUpperArm")]
    assert np.abs(np.diff(arm[95:])).max() < 5.0 and arm[95:].sum() > 20.0


def test_the_head_is_level_for_whoever_was_calibrated_with_a_nose_below_the_ears() -> None:
    x = marks(FACE, np.repeat(POSES[:1], 90, axis=0))
    x[:, FACE.index("nose"), 1] -= 0.05
    turns = joints_of(TREE, played(x, FACE)[0])[0]
    w, x_, y, z = turns[60:, BONES.index("Head")].T
    assert np.abs(np.degrees(np.arcsin(2 * (y * z - w * x_)))).max() < 3.0


def test_ears_that_are_not_seen_leave_the_head_as_it_was_turned() -> None:
    x = marks(FACE, np.repeat(POSES[:1], 120, axis=0))
    x[60:, FACE.index("nose")] += [0.0, 0.2, -0.05]
    x[60:, [FACE.index("ear_l"), FACE.index("ear_r")]] = np.nan
    turns = joints_of(TREE, played(x, FACE)[0])[0][:, BONES.index("Head")]
    away = 2 * np.degrees(np.arccos(np.clip(np.abs(turns[58:] @ turns[58]), 0.0, 1.0)))
    assert away.max() < 3.0


def test_a_head_with_a_nose_and_no_ears_follows_its_marker() -> None:
    names = (*USUAL, "nose")
    x = marks(names, np.repeat(POSES[:1], 120, axis=0))
    x[60:, [names.index("head"), names.index("nose")]] += [0.1, -0.02, 0.0]
    turns = joints_of(TREE, played(x, names)[0])[0][:, BONES.index("Head")]
    assert 2 * np.degrees(np.arccos(np.abs(turns[-1] @ turns[58]))) > 10.0


def test_a_head_that_is_first_seen_late_in_the_calibration_turns_afterwards() -> None:
    turned, at, angle = np.repeat(POSES[:1], 150, axis=0), 3 + 4 * BONES.index("Head"), 0.6
    turned[60:, at], turned[60:, at + 2] = np.cos(angle / 2), np.sin(angle / 2)
    x = marks(FACE, turned)
    x[:20, [FACE.index("ear_l"), FACE.index("ear_r")]] = np.nan
    turns = joints_of(TREE, played(x, FACE, calibrate_s=1.0)[0])[0][:, BONES.index("Head")]
    assert 2 * np.degrees(np.arccos(np.abs(turns[-1] @ turns[58]))) > 25.0


def test_a_nose_that_leaps_for_a_frame_does_not_throw_the_head_back() -> None:
    x = marks(FACE, np.repeat(POSES[:1], 90, axis=0))
    x[60, FACE.index("nose")] += [0.0, 0.25, -0.1]
    turns = joints_of(TREE, played(x, FACE)[0])[0][:, BONES.index("Head")]
    away = 2 * np.degrees(np.arccos(np.clip(np.abs(turns[58:] @ turns[58]), 0.0, 1.0)))
    assert away.max() < 25.0


@pytest.mark.parametrize("seconds", [0.2, 0.4])
@pytest.mark.parametrize("metres", [0.05, 0.3, 0.8])
def test_prediction_overshoots_a_movement_by_less_than_a_tenth(metres: float, seconds: float) -> None:
    u = np.clip((np.arange(0.0, 2.0, 1 / RATE) - 0.5) / seconds, 0.0, 1.0)
    x = metres * (10 * u**3 - 15 * u**4 + 6 * u**5)
    smooth = OneEuro(cutoff_hz=1.0, beta=2.0)(x[:, None], rate_hz=RATE)
    assert Predict(ahead_s=0.033, tau_s=0.15)(smooth, rate_hz=RATE).max() < 1.1 * metres


def swapped(markers: Samples) -> Samples:
    """Markers (n, 20, 3) with left and right exchanged."""
    names = [name.replace("left", "?").replace("right", "left").replace("?", "right") for name in MARKERS]
    return markers[:, [MARKERS.index(name) for name in names]]


def body() -> Samples:
    """A body's markers (20, 3) in the axes of a camera."""
    made = np.zeros((len(MARKERS), 3))
    heights = {
        "shoulder": 0.5,
        "elbow": 0.2,
        "wrist": -0.05,
        "hip": 0.0,
        "knee": -0.42,
        "ankle": -0.84,
        "heel": -0.88,
        "toe": -0.88,
    }
    for k, name in enumerate(MARKERS):
        side, _, joint = name.rpartition("_")
        aside = {"ear": 0.07, "shoulder": 0.18, "elbow": 0.2, "wrist": 0.22}.get(joint, 0.1)
        made[k] = ({"left": aside, "right": -aside}.get(side, 0.0), -heights.get(joint, 0.75), 2.5)
    return made


def test_nothing_is_filled_from_a_way_that_takes_left_for_right() -> None:
    first = np.repeat(body()[None], 4, axis=0)
    second = first.copy()
    missing = [MARKERS.index("left_wrist"), MARKERS.index("right_ankle")]
    first[:, missing] = np.nan
    spec, times = StreamSpec((len(MARKERS), 3), rate_hz=30.0, channels=MARKERS, units=("m",)), grid(30.0, 4)
    for other, filled in ((second, True), (swapped(second), False)):
        surer = Surer()
        surer.open({"first": spec, "second": spec})
        surer.process("second", Chunk(times[:1], other[:1], int(times[0])))
        made = surer.process("first", Chunk(times[:1], first[:1], int(times[0])))
        assert made is not None and np.isfinite(made.data[0, missing]).all() == filled


def test_depth_alone_that_took_left_for_right_finds_out_by_the_shape() -> None:
    frames, _ = someone(7.1, 8.2)
    extrema, times = Extrema(), grid(RATE, len(frames))
    extrema.open({"in": camera_spec()})
    extrema.process("in", Chunk(times[:5], frames[:5], 0))
    extrema.state.heading[:] *= -1.0
    extrema.state.odds = 2.0
    extrema._exchange(ARMS, LEGS)
    made = dict(extrema.process("in", Chunk(times[5:], frames[5:], 0)))["out"].data
    hips = [MARKERS.index("left_hip"), MARKERS.index("right_hip")]
    to_the_left = (made[:, hips[0]] - made[:, hips[1]])[:, 0]
    assert (to_the_left[-8:] > 0.0).all(), "the left hip of who faces the camera is on its right"
