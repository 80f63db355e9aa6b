"""The motion map: places on a PCA that learns as poses come, and never flips or jumps."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import orthogonal_procrustes, subspace_angles

from kinegraph.operators.features.normalised_pose import NormalisedPose
from kinegraph.operators.maps.motion_map import MotionMap
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import grid
from tests.support.real import needs_data

DATA = os.environ.get("KINEGRAPH_DATA", "")
RATE = 60.0


def walk_through(operator: MotionMap, x: Samples, spec: StreamSpec | None = None) -> dict[str, Samples]:
    """Frame by frame: what came out, and the picture's axes and centre after each."""
    operator = operator.unopened()
    operator.open({"in": spec or StreamSpec((x.shape[1],), rate_hz=RATE, units=("cm",))})
    time = grid(RATE, len(x))
    found: dict[str, list[Samples]] = {"map": [], "explained": [], "axes": [], "centre": []}
    for i in range(len(x)):
        for port, chunk in operator.process("in", Chunk(time[i : i + 1], x[i : i + 1], int(time[i]))):  # type: ignore[union-attr]
            found[port].append(chunk.data[0])
        found["axes"].append(operator.state.axes.copy())
        found["centre"].append(operator.state.centre.copy())
    return {name: np.array(rows) for name, rows in found.items()}


def steps_deg(axes: Samples) -> Samples:
    """By how much the axis that turned most did, from frame to frame."""
    chord = np.linalg.norm(np.diff(axes, axis=0), axis=2)
    turned: Samples = np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1.0))).max(axis=1)
    return turned


def principal(x: Samples, k: int) -> Samples:
    axes: Samples = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2]
    return axes[:k]


def slowly(x: Samples, k: int, every: int, max_rad: float) -> tuple[Samples, Samples]:
    """The same by numpy's and scipy's SVDs over all frames so far: axes and centre after each frame.

    A plane is found in 3 c parts, spread over the first half of the time until the next; the first at once.
    """
    axes = target = np.zeros((k, x.shape[1]))
    parts = 3 * x.shape[1]
    takes = -(-parts // -(-parts // (every // 2)))
    centre, found, centres = np.zeros(x.shape[1]), [], []
    for n in range(1, len(x) + 1):
        since = n % every
        if n == every or (n > every and since == takes - 1):
            target = principal(x[: n - since], k)
        if n == every:
            axes = target * np.sign(target[np.arange(k), np.abs(target).argmax(axis=1)])[:, None]
            centre = x[:n].mean(axis=0)
        if n > every:
            there = orthogonal_procrustes(target.T, axes.T)[0].T @ target
            u, cosines, _ = np.linalg.svd(axes @ there.T)
            ours, theirs = u.T @ axes, u.T @ there
            ways = theirs - cosines[:, None] * ours
            angles = np.arctan2(np.linalg.norm(ways, axis=1), cosines)
            ways /= np.maximum(np.linalg.norm(ways, axis=1), 1e-300)[:, None]
            angles = (angles * min(1.0, max_rad / max(angles.max(), 1e-300)))[:, None]
            axes = u @ (np.cos(angles) * ours + np.sin(angles) * ways)
            away, spread = x[:n].mean(axis=0) - centre, np.sqrt(x[:n].var(axis=0).sum())
            centre = centre + away * min(1.0, max_rad * spread / max(float(np.linalg.norm(away)), 1e-300))
        found.append(axes)
        centres.append(centre)
    return np.array(found), np.array(centres)


def changing(n: int) -> Samples:
    """Features with a changing principal plane, and with two largest axes that change places."""
    rng = np.random.default_rng(8)
    scales = ((6, 4, 1, 0.5, 0.3), (4, 9, 1, 0.5, 0.3), (1, 2, 12, 9, 0.3))
    basis = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    x: Samples = np.concatenate([rng.normal(size=(n, 5)) * scale + 3.0 * scale[0] for scale in scales]) @ basis
    return x


@pytest.mark.parametrize("k", [1, 2, 3])
def test_it_agrees_with_svds_of_all_frames_so_far(k: int) -> None:
    x = changing(150)
    found = walk_through(MotionMap(axes=k, learn_s=0.5), x)
    axes, centres = slowly(x, k, 30, np.radians(20.0) / RATE)
    np.testing.assert_allclose(found["axes"][29:], axes[29:], atol=1e-6)
    np.testing.assert_allclose(found["centre"][29:], centres[29:], atol=1e-6)
    places = np.einsum("nkc,nc->nk", axes, x - centres)
    np.testing.assert_allclose(found["map"][29:], places[29:], atol=1e-4)
    assert np.isnan(found["map"][:29]).all() and np.isnan(found["explained"][:29]).all()


@pytest.mark.parametrize("bound", [5.0, 20.0, 120.0])
def test_no_axis_turns_faster_than_the_bound(bound: float) -> None:
    axes = walk_through(MotionMap(rotation_deg_per_s=bound, memory_s=1.0), changing(300))["axes"][59:]
    assert steps_deg(axes).max() * RATE <= bound * (1 + 1e-9)
    planes = [np.degrees(subspace_angles(a.T, b.T).max()) * RATE for a, b in pairwise(axes)]
    assert max(planes) == pytest.approx(bound, rel=1e-6), "else the bound was not needed"


@pytest.mark.parametrize("learn_s", [0.05, 0.2, 1.0])
def test_a_plane_is_found_before_the_next_one_is_begun(learn_s: float) -> None:
    """However seldom or often: at the last frame before the next is begun, the target is the plane of the last whole period."""
    operator, x = MotionMap(learn_s=learn_s), changing(120)
    operator.open({"in": StreamSpec((x.shape[1],), rate_hz=RATE, units=("cm",))})
    every, time = operator.state.every, grid(RATE, len(x))
    for n in range(1, len(x) + 1):
        operator.process("in", Chunk(time[n - 1 : n], x[n - 1 : n], int(time[n - 1])))
        if n >= 20 and n % every == every - 1 and n > every:
            batch = principal(x[: n - every + 1], 2)
            assert np.degrees(subspace_angles(operator.state.target.T, batch.T).max()) < 1e-4


def test_a_pose_that_is_held_stays_where_it_is_as_far_as_the_bound_says() -> None:
    x = changing(300)
    found = walk_through(MotionMap(), x)
    held = x[100]
    places = np.einsum("nkc,nc->nk", found["axes"], held - found["centre"])[59:]
    reach = np.linalg.norm(held - found["centre"], axis=1)[59:]
    spread = np.array([np.sqrt(x[:n].var(axis=0).sum()) for n in range(60, len(x) + 1)])
    limit = np.radians(20.0) / RATE * (reach[:-1] + spread[1:])
    assert (np.linalg.norm(np.diff(places, axis=0), axis=1) <= limit * (1 + 1e-6)).all()


def test_a_plane_with_no_direction_to_it_is_reached() -> None:
    """The new plane stands upright on the old one in both axes: any way is as short."""
    x = np.zeros((1200, 4))
    angle = np.arange(1200) * 2 * np.pi / 20
    x[:60, 0], x[:60, 1] = np.cos(angle[:60]), 0.5 * np.sin(angle[:60])
    x[60:, 2], x[60:, 3] = 9 * np.cos(angle[60:]), 7 * np.sin(angle[60:])
    found = walk_through(MotionMap(), x)
    assert steps_deg(found["axes"][59:]).max() * RATE <= 20.0 * (1 + 1e-9)
    assert np.abs(found["axes"][-1][:, :2]).max() < 1e-6


def test_bad_frames_have_no_place_and_teach_nothing() -> None:
    x = changing(100)
    bad = np.insert(x, 120, x[0] * np.nan, axis=0)
    whole, found = walk_through(MotionMap(), x), walk_through(MotionMap(), bad)
    assert np.isnan(found["map"][120]).all()
    np.testing.assert_array_equal(np.delete(found["map"], 120, 0), whole["map"])
    np.testing.assert_array_equal(found["explained"][120], found["explained"][119])


def test_old_frames_are_forgotten() -> None:
    x = changing(600)
    forgetful, faithful = (walk_through(MotionMap(memory_s=m), x)["axes"][-1] for m in (2.0, 0.0))
    newest = principal(x[-300:], 2)
    assert np.degrees(subspace_angles(forgetful.T, newest.T).max()) < 3.0
    assert np.degrees(subspace_angles(faithful.T, newest.T).max()) > 10.0


def test_missing_channels_are_left_out() -> None:
    x = changing(60)
    spec = StreamSpec((6,), rate_hz=RATE, channels=tuple("abcdef"), units=("cm",), meta={"missing": ["c"]})
    found = walk_through(MotionMap(), np.insert(x, 2, np.nan, axis=1), spec)
    np.testing.assert_array_equal(found["map"], walk_through(MotionMap(), x)["map"])


@pytest.mark.parametrize("width", [1, 151])
def test_a_width_that_cannot_be_is_refused(width: int) -> None:
    with pytest.raises(InputError, match="2 to 150 features"):
        MotionMap().open({"in": StreamSpec((width,), rate_hz=RATE, units=("cm",))})


@needs_data
@pytest.mark.parametrize("k", [2, 3])
def test_real_dogs_end_on_the_plane_of_the_whole_recording(k: int) -> None:
    """Dogs walk, run and turn: 5127 frames of 27 joints, one clip after another; from the chest, the pelvis ahead."""
    clips = np.load(Path(DATA) / "steering" / "dog_mocap_joints.npz")
    joints = np.concatenate([clips[name].astype(float) for name in clips.files])
    pose = NormalisedPose("3", "0")
    spec = pose.open({"in": StreamSpec((27, 3), rate_hz=RATE, units=("m",))})["out"]
    time = grid(RATE, len(joints))
    made = pose.process("in", Chunk(time, joints, int(time[-1])))
    assert made is not None and np.isfinite(made.data).all()
    found = walk_through(MotionMap(axes=k), made.data, spec)
    turned = steps_deg(found["axes"][59:]) * RATE
    assert turned.max() <= 20.0 * (1 + 1e-9)
    batch = principal(made.data, k)
    apart = np.degrees(subspace_angles(found["axes"][-1].T, batch.T).max())
    spread = made.data - made.data.mean(axis=0)
    best = np.sum((spread @ batch.T) ** 2) / np.sum(spread**2)
    print(f"{k} axes: {apart:.2f} degrees apart, {found['explained'][-1].sum():.4f} explained, batch {best:.4f}")
    assert apart < 2.0
    assert found["explained"][-1].sum() == pytest.approx(best, abs=0.002)
