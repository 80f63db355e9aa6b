"""Learning what markers do not show of a pose, from poses that are known whole: kernel ridge regression relative to geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operators.whole_pose.landmarks import BONE_OF, FROM_BONE, NAMES
from operators.whole_pose.prior_kernel import features_of, geometric_prior, heading, middles
from operators.whole_pose.solve_kernel import place_marks
from stream.chunk import Array, Samples, Times
from stream.errors import KinegraphError
from stream.humanoid import BONES
from stream.joint_tree import JointTree, joints_of
from stream.kernel import kernel

WIDTH, RIDGE = 1.0, 0.2
"""Width of the kernel in median distances of poses, and ridge: chosen by leaving out whole subjects."""
MOST_FRAMES = 40_000
LEFT_OUT = 1e-3
"""The share of the corrections' variance that is given up for speed."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """What a training has to learn from: features (n, 3 m) and targets (n, 6 * 22 + 3) of all its frames."""

    features: Samples
    targets: Samples


@kernel
def see_poses(
    marks: Samples,
    chosen: Times,
    present: Array,
    offsets: Samples,
    root: Samples,
    joints: Samples,
    features: Samples,
    priors: Samples,
    hips: Samples,
    work: Samples,
) -> None:
    """What the markers of known poses show, and the geometric prior: for each of `marks` (n, m, 3), as the operator will see it."""
    left = work[8, :3]
    left[0], left[1], left[2] = 1.0, 0.0, 0.0
    for i in range(marks.shape[0]):
        heading(marks[i], present, left)
        geometric_prior(marks[i], present, 1.0, left, offsets, priors[i], joints[i], work[:8])
        low = work[4, :3]
        middles(marks[i], present, 1.0, low, work[5, :3])
        features_of(marks[i], chosen, low, left, 1.0, features[i])
        x, z = root[i, 0] - low[0], root[i, 2] - low[2]
        hips[i, 0] = x * left[0] + z * left[2]
        hips[i, 1] = root[i, 1] - low[1]
        hips[i, 2] = z * left[0] - x * left[2]


def lesson_of(tree: JointTree, poses: Samples, chosen: Times) -> Lesson:
    """What the poses (n, 3 + 4 * 22) of a humanoid skeleton teach about its landmarks `chosen` (m,)."""
    turns, joints = joints_of(tree, poses)
    present = np.isin(np.arange(len(NAMES)), chosen)
    marks = np.zeros((len(poses), len(NAMES), 3))
    for i in range(len(poses)):
        place_marks(FROM_BONE, BONE_OF, turns[i], joints[i], present, marks[i])
    n = len(poses)
    features, priors, hips = np.empty((n, 3 * len(chosen))), np.empty((n, len(BONES), 4)), np.empty((n, 3))
    placed = np.empty((n, len(BONES), 3))
    see_poses(
        marks, chosen, present, tree.offsets, joints[:, 0].copy(), placed, features, priors, hips, np.zeros((9, 4))
    )
    return Lesson(features, np.hstack([_six(priors, turns).reshape(n, -1), hips]))


def mirrored(lesson: Lesson, chosen: Times) -> Lesson:
    """What the same poses teach in a mirror: either side of the body can do what one was seen to do. Landmarks that have no counterpart
    among those `chosen` leave the lesson as it is."""
    n, names = len(lesson.features), [NAMES[k] for k in chosen]
    if not {other_side(name) for name in names} <= set(names):
        return lesson
    marks = [names.index(other_side(name)) for name in names]
    bones = [BONES.index(other_side(bone)) for bone in BONES]
    features = (lesson.features.reshape(n, -1, 3) * [-1.0, 1.0, 1.0])[:, marks]
    turns = lesson.targets[:, :-3].reshape(n, -1, 6)[:, bones] * [1.0, -1.0, -1.0, -1.0, 1.0, 1.0]
    targets = np.hstack([turns.reshape(n, -1), lesson.targets[:, -3:] * [-1.0, 1.0, 1.0]])
    return Lesson(features.reshape(n, -1), targets)


def other_side(name: str) -> str:
    """What a bone or a landmark is called on the other side; its own name where it has no side."""
    for one, other in (("Left", "Right"), ("Right", "Left")):
        if name.startswith(one):
            return other + name.removeprefix(one)
    for one, other in (("_l", "_r"), ("_r", "_l")):
        if name.endswith(one):
            return name.removesuffix(one) + other
    return name


def _six(priors: Samples, turns: Samples) -> Samples:
    """Rotations from `priors` to `turns` (n, j, 4) by two columns of their matrices (n, j, 6)."""
    a = priors * [1.0, -1.0, -1.0, -1.0]
    w = a[..., 0] * turns[..., 0] - (a[..., 1:] * turns[..., 1:]).sum(-1)
    v = a[..., :1] * turns[..., 1:] + turns[..., :1] * a[..., 1:] + np.cross(a[..., 1:], turns[..., 1:])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    first = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    second = [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]
    return np.stack([*first, *second], axis=-1)


def learn_pose(
    lessons: Sequence[Lesson], chosen: Times, centres: int, width: float = WIDTH, ridge: float = RIDGE
) -> dict[str, Array]:
    """Kernel centres, weights, their basis, mean and scale: ridge regression on all frames, as they are and in a mirror, with Gaussian
    kernels at `centres` of them.

    chosen  (m,)  the landmarks that the lessons are on

    The centres are frames as far from one another as can be (farthest points in turn). Raises KinegraphError for too few frames.
    """
    if (frames := sum(len(one.features) for one in lessons)) < 50:
        raise KinegraphError(f"{frames} poses are too few to learn from; at least 50 are needed")
    both = [each for one in lessons for each in (one, mirrored(one, chosen))]
    x, y = np.concatenate([one.features for one in both]), np.concatenate([one.targets for one in both])
    if len(x) > MOST_FRAMES:
        thin = np.linspace(0, len(x) - 1, MOST_FRAMES).astype(np.intp)
        x, y = x[thin], y[thin]
    sample = x[:: max(1, len(x) // 400)]
    scale = 1.0 / (
        2.0 * (width * float(np.median(_squares(sample, sample)[np.triu_indices(len(sample), 1)] ** 0.5))) ** 2
    )
    at = x[_far_apart(x, min(centres, len(x)))]
    mean = y.mean(axis=0)
    left, right = np.zeros((len(at), len(at))), np.zeros((len(at), y.shape[1]))
    for part in range(0, len(x), 4096):
        k = np.exp(-scale * _squares(x[part : part + 4096], at))
        left += k.T @ k
        right += k.T @ (y[part : part + 4096] - mean)
    left += ridge * np.exp(-scale * _squares(at, at)) + 1e-9 * np.eye(len(at))
    weights: Samples = np.asarray(np.linalg.solve(left, right), np.float64)
    weights, basis = _in_few(weights, np.exp(-scale * _squares(x[:: max(1, len(x) // 2000)], at)) @ weights)
    return {"centres": at, "weights": weights, "basis": basis, "mean": mean, "scale": np.array([scale])}


def _in_few(weights: Samples, predicted: Samples) -> tuple[Samples, Samples]:
    """Weights (c, q) by those directions of the predictions (n, q) that hold all but `LEFT_OUT` of their variance: (c, r) and (r, q)."""
    _, size, directions = np.linalg.svd(predicted, full_matrices=False)
    share = np.cumsum(size**2) / np.sum(size**2)
    basis = np.ascontiguousarray(directions[: int(np.searchsorted(share, 1.0 - LEFT_OUT)) + 1])
    return np.ascontiguousarray(weights @ basis.T), basis


def _squares(a: Samples, b: Samples) -> Samples:
    """Squared distances (n, m) of the rows of `a` (n, d) and `b` (m, d)."""
    return np.asarray(np.maximum((a**2).sum(1)[:, None] + (b**2).sum(1) - 2.0 * a @ b.T, 0.0))


def _far_apart(x: Samples, count: int) -> Times:
    """Numbers of `count` rows of `x` (n, d), each as far as can be from those before it."""
    nearest, at = np.full(len(x), np.inf), 0
    found = np.empty(count, np.int64)
    for k in range(count):
        found[k] = at
        nearest = np.minimum(nearest, ((x - x[at]) ** 2).sum(1))
        at = int(nearest.argmax())
    return found
