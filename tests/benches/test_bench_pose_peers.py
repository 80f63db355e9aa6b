"""bench.pose_peers counts limbs that are wrong by known amounts, turns people to the camera, and kalidokit solves what it is given."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from bench import pose_peers
from bench.engines import EngineError
from bench.pose_peers import ENDS, _mean_turn, _row, _turns, fetched, kalidokit, ways
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES, usual_body

TREE = usual_body()
REST = np.concatenate([TREE.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])


def turned(pose: Samples, bone: str, angle: float, axis: int) -> Samples:
    """A pose with one bone turned about an axis of the parent."""
    made, at = pose.copy(), 3 + 4 * BONES.index(bone)
    made[at : at + 4] = 0.0
    made[at], made[at + 1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return made


def lowered(n: int) -> Samples:
    """Poses (n, 91) of somebody who lowers the arms from the sides, with elbows and knees a little bent: straight ones give it NaN."""
    bent = REST
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        bent = turned(turned(bent, f"{side}UpperLeg", -0.3, 0), f"{side}LowerLeg", 0.4, 0)
        bent = turned(bent, f"{side}LowerArm", -0.3 * sign, 1)
    poses = []
    for k in range(n):
        low = 0.2 + 0.8 * k / n
        poses.append(turned(turned(bent, "LeftUpperArm", -low, 2), "RightUpperArm", low, 2))
    return np.array(poses)


def test_limbs_that_are_wrong_by_a_known_angle_count_so_much() -> None:
    truth = np.repeat(REST[None], 4, axis=0)
    wrong = np.array([turned(REST, "LeftLowerArm", 0.4, 1)] * 4)
    cm, deg, median, p99 = _row(TREE, [(wrong, np.array([1.0, 2.0, 3.0, 50.0]))], [truth])
    forearm = float(np.linalg.norm(TREE.offsets[BONES.index("LeftHand")]))
    assert deg == pytest.approx(np.degrees(0.4) / len(ENDS), rel=1e-6)
    assert cm == pytest.approx(100 * 2 * forearm * np.sin(0.2) / len(ENDS), rel=1e-6)
    assert median == pytest.approx(2.5) and 3.0 < p99 <= 50.0


def test_somebody_is_turned_to_the_camera() -> None:
    poses = np.array([turned(REST, "Hips", angle, 1) for angle in (0.3, 0.5, 0.7)])
    assert _turns(TREE, poses).as_rotvec()[:, 1] == pytest.approx([-0.3, -0.5, -0.7], abs=1e-6)
    assert _mean_turn(TREE, poses).as_rotvec()[:, 1] == pytest.approx([-0.5] * 3, abs=1e-6)


def test_there_are_sixteen_ways_to_lie_on_the_skeleton() -> None:
    assert len(set(ways())) == 16


def test_without_npm_kalidokit_is_left_out_with_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_peers.shutil, "which", lambda name: None)
    with pytest.raises(EngineError, match="needs node and npm"):
        fetched(tmp_path)


def test_kalidokit_follows_arms_that_are_lowered(tmp_path: Path) -> None:
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("no npm and node here: kalidokit is a package of npm's")
    try:
        library = fetched(tmp_path)
    except EngineError as error:
        pytest.skip(f"npm's registry cannot be reached: {error}")
    poses = lowered(12)
    make, took = kalidokit(library, tmp_path, TREE, poses, _turns(TREE, poses))
    assert took.shape == (12,) and (took > 0.0).all()
    rows = [_row(TREE, [(make(*way), took)], [poses]) for way in ways()]
    assert np.isfinite(rows).all()
    best, worst = min(row[1] for row in rows), max(row[1] for row in rows)
    assert best < 15.0 and worst > 30.0, "no way lies on our skeleton"
