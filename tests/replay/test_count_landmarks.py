"""configs/count_landmarks.yaml: repetitions in landmarks that another program found in a video.

Recording: a workout of CMU's motion capture (subject 13; labels of mocap6, BSD-2), as a network sees it in a video taken 35 degrees from
the side: 33 landmarks in pixels, 1 cm of noise across and up, 10 cm in depth. Of videos none may be kept here.
Truth: peaks that scipy finds in the height of a wrist or of the head between the labels, which were made by hand.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import find_peaks

import kinegraph as kg
from kinegraph.devices.formats.table.landmarks import LANDMARKS
from kinegraph.operators.features.pose import Pose
from kinegraph.stream.chunk import NS, Array, Samples
from tests.replay.replaying import cmu_joints, signal
from tests.support.command_line import call_command
from tests.support.real import real_arrays

JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
PIXELS_PER_M = 300.0


def landmarks() -> tuple[Samples, Array]:
    """The workout in a picture (frames, 33, 3) px, and in space (frames, 13, 3) m: the joints of both sides, and the head."""
    names = [*(f"{joint}_{side}" for joint in JOINTS for side in "lr"), "head"]
    space, rng = cmu_joints("13_29", names), np.random.default_rng(1)
    near = space - space[:, [names.index("hip_l")]]
    turn = np.deg2rad(35.0)
    across = np.cos(turn) * near[..., 0] + np.sin(turn) * near[..., 2]
    picture = np.stack([across, -near[..., 1], np.zeros_like(across)], axis=2)
    picture += rng.normal(0.0, 1.0, picture.shape) * (0.01, 0.01, 0.1)
    other = {"pinky": "wrist", "index": "wrist", "thumb": "wrist", "heel": "ankle"}
    chosen = []
    for name in LANDMARKS:
        side, _, part = name.partition("_")
        part = "ankle" if part == "foot_index" else other.get(part, part)
        chosen.append(names.index(f"{part}_{side[0]}") if part in JOINTS else names.index("head"))
    return picture[:, chosen] * PIXELS_PER_M + (320.0, 240.0, 0.0), space[
        :, [names.index("wrist_r"), names.index("head")], 1
    ]


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Array, Array]:
    """The middles of repetitions (s), and the heights of wrist and head."""
    folder = tmp_path_factory.mktemp("landmarks")
    seen, heights = landmarks()
    np.save(folder / "workout.npy", seen.reshape(len(seen), -1).astype(np.float32))
    recording = folder / "workout.mcap"
    call_command(
        "files",
        "import",
        folder / "workout.npy",
        "--kinect",
        "--rate",
        30,
        "-o",
        recording,
        "--stream",
        "video.joints=workout",
    )
    rows = kg.load("count_landmarks").run(recording, keep=["repetitions.segment.primitive"])
    found = rows["repetitions.segment.primitive"].data
    found = found[found["repetition"] > 0]
    return (found["onset"] + found["end"]) / 2 / NS, heights


@pytest.mark.parametrize(("exercise", "part"), [("JumpJack", 0), ("ArmCircle", 0), ("Squat", 1)])
def test_as_many_repetitions_are_counted_as_a_height_has_peaks(
    counted: tuple[Array, Array], exercise: str, part: int
) -> None:
    middles, heights = counted
    file = real_arrays("segmentation/mocap6/13_29.npz")
    during = np.flatnonzero(file["label"] == file["label_names"].tolist().index(exercise))
    height = heights[during, part] * (1 if part == 0 else -1)
    peaks, _ = find_peaks(height, prominence=0.3 * np.ptp(height))
    found = ((middles > during[0] / 30) & (middles < during[-1] / 30)).sum()
    assert len(peaks) >= 2 and abs(found - len(peaks)) <= 1


def test_how_far_away_a_joint_is_is_left_out() -> None:
    """Another depth of every joint, and nothing changes."""
    seen, _ = landmarks()
    near, far = (
        signal(made / PIXELS_PER_M, 30.0, LANDMARKS, ["m"]) for made in (seen[:300], seen[:300] * (1.0, 1.0, 7.0))
    )
    made = [kg.load("count_landmarks").run({"video.joints": one}, keep=["features.stack"]) for one in (near, far)]
    assert np.array_equal(made[0]["features.stack"].data, made[1]["features.stack"].data, equal_nan=True)


def test_the_neck_is_between_the_shoulders_where_no_point_is_called_so() -> None:
    seen, _ = landmarks()
    made = Pose(points="e30", heading=False, up="-y")(
        seen[:5] / PIXELS_PER_M, rate_hz=30, channels=LANDMARKS, units=["m"]
    )
    assert made.shape == (5, 30)
