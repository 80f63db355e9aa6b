"""configs/segment_kinect.yaml: what somebody does before a depth camera, from the joints that it sees.

Recording: no recording of a Kinect may be kept. A workout of CMU's motion capture (subject 13; labels of mocap6, BSD-2) is seen as a
Kinect sees it: 20 joints with 5 mm of noise, 28 to 30 frames a second, every fiftieth joint lost.
Truth: the labels, made by hand.
"""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score

import kinegraph as kg
from kinegraph.stream.chunk import NS
from tests.replay.replaying import cmu_joints, signal
from tests.support.real import real_arrays

GRAPH = kg.load("segment_kinect")
LABELS = real_arrays("segmentation/mocap6/13_29.npz")["label"]


@pytest.fixture(scope="module")
def activities() -> np.ndarray:
    names, random = (
        GRAPH.specs["kinect.joints" if "kinect.joints" in GRAPH.specs else "kinect"].channels,
        np.random.default_rng(1),
    )
    exact = cmu_joints("13_29", names)
    seconds = np.cumsum(random.uniform(1 / 30, 1 / 28, len(exact)))
    seconds = seconds[seconds < (len(exact) - 1) / 30]
    flat = [np.interp(seconds, np.arange(len(exact)) / 30, column) for column in exact.reshape(len(exact), -1).T]
    seen = np.stack(flat, axis=1).reshape(-1, *exact.shape[1:]) + random.normal(
        0.0, 0.005, (len(seconds), *exact.shape[1:])
    )
    seen[random.random(seen.shape[:2]) < 0.02] = np.nan
    joints = signal(seen, None, names, ["m"], time_s=seconds)
    return np.asarray(GRAPH.run({"kinect.joints": joints}, keep=["segment.activity"])["segment.activity"].data)


def test_an_activity_begins_where_the_annotator_saw_another_exercise(activities: np.ndarray) -> None:
    """Within a second, four of five: the first exercise, of 4 s, is taken for the next one. Noise cuts squats and toe touches in two more
    often than motion capture's joints do."""
    changes = (np.flatnonzero(np.diff(LABELS)) + 1) / 30
    begins = activities["onset"][1:] / NS
    assert (np.abs(changes[:, None] - begins).min(axis=1) < 1.0).sum() >= 4
    assert len(begins) <= len(changes) + 3


def test_activities_and_labels_agree(activities: np.ndarray) -> None:
    activity = np.searchsorted(activities["onset"] / NS, np.arange(len(LABELS)) / 30, "right")
    assert adjusted_rand_score(LABELS, activity) > 0.7
