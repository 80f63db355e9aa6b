"""configs/motion_map.yaml: where a body's pose is among all poses so far, live, from markers.

Recording: a workout of CMU's motion capture (subject 13; labels of mocap6, BSD-2), markers named as other programs name them.
Truth: numpy's PCA of the same poses at the end; the annotators' labels.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from tests.replay.replaying import cmu_joints, signal
from tests.support.real import real_arrays

LABELS = real_arrays("segmentation/mocap6/13_29.npz")["label"]
OURS = ("hip_l", "hip_r", "knee_l", "knee_r", "ankle_l", "ankle_r", "wrist_l", "wrist_r")
THEIRS = ("left_hip", "right_hip", "LKNE", "RKNE", "LeftAnkle", "RightAnkle", "left_wrist", "right_wrist")


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    joints = cmu_joints("13_29", OURS)
    graph = kg.load("motion_map")
    markers = signal(joints, 30.0, THEIRS, ["m"])
    pose = kg.Series("", graph.specs["performer.pose"], markers.time[:1], np.zeros((1, 91)))
    return graph.run(
        {"performer.markers": markers, "performer.pose": pose}, keep=["even", "map.map", "grid.place", "grid.error"]
    )


def test_the_map_spreads_poses_as_a_pca_of_the_whole_does(replayed: kg.Results) -> None:
    poses, place = replayed["even"].data, replayed["map.map"].data
    last = slice(len(poses) // 2, None)
    centred = poses[last] - poses[last].mean(axis=0)
    known = np.isfinite(place[last]).all(axis=1)
    _, _, axes = np.linalg.svd(centred[known], full_matrices=False)
    offline = centred[known] @ axes[:2].T
    live = place[last][known] - place[last][known].mean(axis=0)
    kept = np.linalg.norm(np.linalg.lstsq(live, offline, rcond=None)[0].T @ live.T - offline.T) / np.linalg.norm(
        offline
    )
    assert known.mean() > 0.99 and kept < 0.5, "the live plane follows that of the whole"


def test_poses_of_one_exercise_are_nearer_to_one_another_on_the_grid_than_those_of_others(replayed: kg.Results) -> None:
    place = replayed["grid.place"].data
    known = np.flatnonzero(np.isfinite(place).all(axis=1))[::10]
    label = LABELS[known.clip(max=len(LABELS) - 1)]
    apart = np.linalg.norm(place[known][:, None] - place[known][None], axis=2)
    same = label[:, None] == label[None]
    assert apart[same].mean() < 0.8 * apart[~same].mean()
