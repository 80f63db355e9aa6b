"""Markers whose up axis is another one than `up` says: that is said, and not of people who lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import structlog

from kinegraph.devices.people.quadruped import marked, topology
from kinegraph.operators.pose.landmarks import BONE_OF, NAMES
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of, multiply
from kinegraph.stream.operator import grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.avatar.test_steering import STRIDE
from tests.support.command_line import Command

RATE, N = 30.0, 150
UPS = ("y", "z", "-y")
"""What `up` of WholePose may be."""


def person(pace_m_s: float) -> Samples:
    """Markers (n, 13, 3), y up, of somebody upright who goes along z."""
    tree = usual_body()
    poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (N, 1))
    marks = joints_of(tree, poses)[1][:, BONE_OF[:13]]
    marks[:, 12, 1] += 0.1
    swing = 0.2 * np.sin(2 * np.pi * np.arange(N) / RATE)
    marks[:, :, 2] += (pace_m_s * np.arange(N) / RATE)[:, None]
    for ankle, knee, side in ((4, 2, 1.0), (5, 3, -1.0)):
        marks[:, ankle, 2] += side * swing
        marks[:, knee, 2] += 0.5 * side * swing
    return marks


def turned(marks: Samples, axis: str) -> Samples:
    """The same in coordinates in which `axis` points up."""
    x, y, z = np.moveaxis(marks, -1, 0)
    return np.stack({"y": (x, y, z), "z": (x, -z, y), "-y": (x, -y, -z), "x": (y, -x, z)}[axis], axis=-1)


def warnings_of(marks: Samples, up: str, names: tuple[str, ...] = NAMES[:13]) -> list[str]:
    operator = WholePose(up=up)  # type: ignore[arg-type]
    operator.open({"in": StreamSpec((13, 3), rate_hz=RATE, channels=names, units=("m",))})
    rows, times = marks.reshape(len(marks), -1), grid(RATE, len(marks))
    with structlog.testing.capture_logs() as logs:
        for first in range(0, len(rows), 7):
            part = slice(first, first + 7)
            operator.process("in", Chunk(times[part], rows[part], int(times[part][-1])))
    return [entry["event"] for entry in logs if entry["log_level"] == "warning"]


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("axis", [*UPS, "x"])
def test_who_walks_along_another_axis_is_noticed_once(axis: str, up: str) -> None:
    reported = warnings_of(turned(person(0.6), axis), up)
    if axis == up:
        assert not reported
        return
    assert len(reported) == 1 and f"upright along {axis} of the markers, but `up` is {up}" in reported[0]
    assert (f"set `up: {axis}`" in reported[0]) == (axis in UPS)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("pace_m_s", [0.0, 0.05])
def test_who_lies_is_not_taken_for_somebody_who_walks(up: str, pace_m_s: float) -> None:
    """Without going anywhere nobody can tell; nothing is said."""
    assert not warnings_of(turned(person(pace_m_s), {"y": "z", "z": "y"}[up]), up)


def test_who_lies_first_and_gets_up_or_crawls_is_not_warned_about() -> None:
    lying = turned(person(0.0), "z")
    crawling = turned(person(0.0), "z")
    crawling[:, :, 2] += 0.4 * np.arange(N)[:, None] / RATE
    assert not warnings_of(np.concatenate([lying[:75], person(0.6)]), "y")
    assert not warnings_of(crawling, "y")


def test_a_person_of_whom_the_head_is_not_seen_is_not_judged() -> None:
    marks = turned(person(0.6), "z")
    marks[:, 12] = np.nan
    assert not warnings_of(marks, "y")


@pytest.mark.parametrize("axis", ["y", "z"])
def test_a_training_of_poses_names_a_recording_of_another_axis(axis: str, tmp_path: Path, kinegraph: Command) -> None:
    tree, half = usual_body(), np.sqrt(0.5)
    poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (N, 1))
    poses[:, 3:] += 0.01 * np.random.default_rng(4).normal(size=(N, 4 * len(BONES))).cumsum(axis=0)
    poses[:, 3:] = (
        poses[:, 3:].reshape(N, -1, 4) / np.linalg.norm(poses[:, 3:].reshape(N, -1, 4), axis=2, keepdims=True)
    ).reshape(N, -1)
    poses[:, 0] += 0.6 * np.arange(N) / RATE
    if axis == "z":
        for pose in poses:
            multiply(np.array([half, half, 0.0, 0.0]), pose[3:7].copy(), pose[3:7])
    write_recording(tmp_path / "walk.mcap", [Series("body", tree.spec(RATE), grid(RATE, N), poses)], {})
    code, _, output = kinegraph(
        "motion", "train", "pose", tmp_path / "walk.mcap", "-o", tmp_path / "m.npz", "--centres", "50"
    )
    assert code == 0 and (tmp_path / "m.npz").exists(), output
    assert ("walk: body: somebody walks upright along z; turn it: y must point up" in output) == (axis == "z"), output


@pytest.mark.parametrize("tilted", [False, True])
def test_a_training_of_a_mesh_whose_heading_points_up_says_so(tilted: bool, tmp_path: Path, kinegraph: Command) -> None:
    frames = STRIDE[::2][..., [0, 2, 1]] * [1.0, 1.0, -1.0] if tilted else STRIDE[::2]
    write_recording(
        tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, len(frames)), frames)], {}
    )
    markers = ", ".join(f"{name}: {vertex}" for name, vertex in marked().items())
    (tmp_path / "m.yaml").write_text(f"markers: {{{markers}}}\nheading: [croup, withers]\n")
    code, _, output = kinegraph(
        "motion", "train", "steering", tmp_path / "mesh.mcap", "--markers", tmp_path / "m.yaml", "-o", tmp_path / "m.npz",
        "--method", "straight",
    )  # fmt: skip
    assert code == 0 and (tmp_path / "m.npz").exists(), output
    assert ("mesh.mcap: the heading's markers lie above one another" in output) == tilted, output
