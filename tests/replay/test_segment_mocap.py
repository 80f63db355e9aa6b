"""configs/segment_mocap.yaml: which exercises somebody does, where each begins, and how often it is repeated, from motion capture.

Recordings: subject 13 of CMU's motion capture database in two workouts, 31 joints at 30 Hz; the labels are of M. Hughes's mocap6 (BSD-2),
made by hand, one exercise after another without a pause.
Truth: those labels; how well they and the graph's activities agree is scikit-learn's figure. Single repetitions are not labelled.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import signal
from tests.support.real import real_arrays

RATE = 30.0


@cache
def replayed(name: str) -> kg.Results:
    file = real_arrays(f"segmentation/mocap6/{name}.npz")
    joints = signal(file["joints_mm"] / 1000.0, RATE, map(str, file["joint_names"]), ["m"])
    return kg.load("segment_mocap").run(
        {"mocap.joints": joints}, keep=["segment.activity", "segment.primitive", "pose"]
    )


def labels(name: str) -> Array:
    return real_arrays(f"segmentation/mocap6/{name}.npz")["label"]


@pytest.mark.parametrize(("name", "missed"), [("13_29", 1), ("13_31", 1)])
def test_an_activity_begins_where_the_annotator_saw_another_exercise(name: str, missed: int) -> None:
    """Within a second. The first workout's first exercise, of 4 s, is taken for the next one; one toe touch between twists of the second
    one is too short to be seen."""
    changes = (np.flatnonzero(np.diff(labels(name))) + 1) / RATE
    begins = replayed(name)["segment.activity"].data["onset"][1:] / NS
    assert (np.abs(changes[:, None] - begins).min(axis=1) > 1.0).sum() <= missed
    assert len(begins) <= len(changes) + 1


@pytest.mark.parametrize(("name", "least"), [("13_29", 0.75), ("13_31", 0.5)])
def test_activities_and_labels_agree(name: str, least: float) -> None:
    truth = labels(name)
    begins = replayed(name)["segment.activity"].data["onset"] / NS
    activity = np.searchsorted(begins, np.arange(len(truth)) / RATE, "right")
    assert adjusted_rand_score(truth, activity) > least


def test_repetitions_lie_within_one_exercise() -> None:
    rows = replayed("13_29")["segment.primitive"].data
    rows = rows[rows["repetition"] > 0]
    truth = labels("13_29")
    first, last = (truth[(rows[edge] / NS * RATE).astype(int).clip(0, len(truth) - 1)] for edge in ("onset", "end"))
    assert len(rows) >= 8
    assert (first == last).mean() > 0.65  # the first and the last of an exercise may reach into the next


def test_a_pose_is_seen_from_the_hips_and_turned_to_the_front() -> None:
    """The left wrist by numpy: from the middle of the hips, along the line through them, in cm."""
    file = real_arrays("segmentation/mocap6/13_29.npz")
    joint = {str(name): file["joints_mm"][:, i] / 10.0 for i, name in enumerate(file["joint_names"])}
    across = joint["lhipjoint"] - joint["rhipjoint"]
    turn = np.arctan2(across[:, 2], across[:, 0])
    wrist = joint["lradius"] - joint["root"]
    left = wrist[:, 0] * np.cos(turn) + wrist[:, 2] * np.sin(turn)
    pose = replayed("13_29")["pose"]
    column = next(i for i, name in enumerate(pose.spec.channels) if name.startswith("wrist_l"))
    np.testing.assert_allclose(
        pose.data[:, column + 1], wrist[:, 1], atol=12.0
    )  # the graph's root is the middle of the hips
    assert np.corrcoef(pose.data[:, column], left)[0, 1] > 0.98
