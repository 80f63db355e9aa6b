"""Learning what markers do not show of a pose, from poses that are known whole: kernel ridge regression relative to geometry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.maps.motion_graph.takes import mirrored_poses, mirrored_tree
from kinegraph.operators.pose.landmarks import BONE_OF, FROM_BONE, NAMES
from kinegraph.operators.pose.prior_kernel import features_of, geometric_prior, heading, middles
from kinegraph.operators.pose.regions_kernel import REGIONS, numbers_of, regional_of, shown_by_region
from kinegraph.operators.pose.solve_kernel import place_marks
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.kernel import kernel

WIDTH, RIDGE = 1.0, 0.2
"""Widths of the kernels in median distances of poses, and ridge."""
MOST_FRAMES = 40_000
LEFT_OUT = 1e-3
"""The share of the corrections' variance that is given up for speed."""
ALIKE = 1e-6
"""Rows less far apart than this share of their largest number are alike: their squared distances are differences of squares."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """What a training has to learn from: of all its frames features (n, 3 m) of the whole body, those of its regions by themselves, and
    targets (n, 6 * 22 + 3)."""

    features: Samples
    regional: Samples
    targets: Samples


@kernel
def see_poses(
    marks: Samples,
    chosen: Times,
    shown: Times,
    present: Array,
    offsets: Samples,
    root: Samples,
    joints: Samples,
    features: Samples,
    regional: Samples,
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
        regional_of(marks[i], shown, low, work[5, :3], priors[i], 1.0, regional[i], work)
        x, z = root[i, 0] - low[0], root[i, 2] - low[2]
        hips[i, 0] = x * left[0] + z * left[2]
        hips[i, 1] = root[i, 1] - low[1]
        hips[i, 2] = z * left[0] - x * left[2]


def lessons_of(tree: JointTree, poses: Samples, chosen: Times, noise_m: float = 0.0) -> tuple[Lesson, Lesson]:
    """What the poses (n, 3 + 4 * 22) of a humanoid skeleton teach, as they are and in a mirror: people of whom nothing was recorded use
    either hand. See `lesson_of`."""
    return (
        lesson_of(tree, poses, chosen, noise_m),
        lesson_of(mirrored_tree(tree), mirrored_poses(poses), chosen, noise_m),
    )


def lesson_of(tree: JointTree, poses: Samples, chosen: Times, noise_m: float = 0.0) -> Lesson:
    """What the poses (n, 3 + 4 * 22) of a humanoid skeleton teach about its landmarks `chosen` (m,), which err by `noise_m` (deviation)."""
    turns, joints = joints_of(tree, poses)
    present = np.isin(np.arange(len(NAMES)), chosen)
    marks = np.zeros((len(poses), len(NAMES), 3))
    for i in range(len(poses)):
        place_marks(FROM_BONE, BONE_OF, turns[i], joints[i], present, marks[i])
    n, (shown, ends) = len(poses), shown_by_region(chosen)
    if noise_m:
        marks[:, chosen] += np.random.default_rng([18, n]).normal(0.0, noise_m, (n, len(chosen), 3))
    features, regional, hips = np.empty((n, 3 * len(chosen))), np.empty((n, int(ends[-1]))), np.empty((n, 3))
    priors, placed = np.empty((n, len(BONES), 4)), np.empty((n, len(BONES), 3))
    see_poses(
        marks, chosen, shown, present, tree.offsets, joints[:, 0].copy(), placed, features, regional, priors, hips, np.zeros((9, 4))
    )  # fmt: skip
    return Lesson(features, regional, np.hstack([_six(priors, turns).reshape(n, -1), hips]))


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
    lessons: Sequence[Lesson],
    chosen: Times,
    centres: int,
    width: float = WIDTH,
    regional_width: float = WIDTH,
    ridge: float = RIDGE,
) -> dict[str, Array]:
    """The arrays of `Corrections`: ridge regression on all frames, with kernels at `centres` of them.

    chosen  (m,)  the landmarks that the lessons are on

    What a region of the body says goes by the sum of two Gaussian kernels, of the whole body's pose and of the region's own: limbs also do
    together what they were never seen to do together. The centres are frames as far from one another as can be (farthest points in turn).
    Raises KinegraphError for too few frames.
    """
    if (frames := sum(len(one.features) for one in lessons)) < 50:
        raise KinegraphError(f"{frames} poses are too few to learn from; at least 50 are needed")
    x, own, y = (
        np.concatenate([getattr(one, name) for one in lessons]) for name in ("features", "regional", "targets")
    )
    if len(x) > MOST_FRAMES:
        thin = np.linspace(0, len(x) - 1, MOST_FRAMES).astype(np.intp)
        x, own, y = x[thin], own[thin], y[thin]
    ends, mean = shown_by_region(chosen)[1], y.mean(axis=0)
    scales = np.array(
        [scale_of(x, width), *(scale_of(own[:, ends[k] : ends[k + 1]], regional_width) for k in range(REGIONS))]
    )
    at = _far_apart(x, min(centres, len(x)))
    centre = (x[at], own[at], ends, scales)
    lefts = np.zeros((REGIONS, len(at), len(at)))
    rights = [np.zeros((len(at), len(numbers_of(k)))) for k in range(REGIONS)]
    for part in range(0, len(x), 4096):
        rows = slice(part, part + 4096)
        for k, near in enumerate(_kernels(x[rows], own[rows], *centre)):
            lefts[k] += near.T @ near
            rights[k] += near.T @ (y[rows] - mean)[:, numbers_of(k)]
    every = max(1, len(x) // 2000)
    seen = _kernels(x[::every], own[::every], *centre)
    weights, bases = [], []
    for k, among in enumerate(_kernels(x[at], own[at], *centre)):
        left = lefts[k] + ridge * among + 1e-9 * np.eye(len(at))
        solved, narrow = _in_few(np.asarray(np.linalg.solve(left, rights[k]), np.float64), next(seen))
        basis = np.zeros((len(narrow), y.shape[1]))
        basis[:, numbers_of(k)] = narrow
        weights.append(solved)
        bases.append(basis)
    ranks = np.cumsum([0, *(len(basis) for basis in bases)])
    return {
        "centres": x[at], "regional": own[at], "weights": np.hstack(weights), "basis": np.concatenate(bases), "mean": mean,
        "scales": scales, "ranks": ranks,
    }  # fmt: skip


def _kernels(
    x: Samples, own: Samples, centres: Samples, regional: Samples, ends: Times, scales: Samples
) -> Iterator[Samples]:
    """For each region the kernel (n, c) of the frames `x` (n, 3 m), `own` (n, 3 k) with the centres; see `Corrections`."""
    whole = _gaussian(x, centres, scales[0])
    for k in range(REGIONS):
        columns = slice(ends[k], ends[k + 1])
        yield whole + _gaussian(own[:, columns], regional[:, columns], scales[1 + k])


def scale_of(x: Samples, width: float) -> float:
    """1 / (2 w^2) for a `width` in median distances of the rows of `x`; 0 where most are alike but for rounding, or have no columns."""
    sample = x[:: max(1, len(x) // 400)]
    median = float(np.median(_squares(sample, sample)[np.triu_indices(len(sample), 1)] ** 0.5))
    return 1.0 / (2.0 * (width * median) ** 2) if median > ALIKE * np.abs(sample).max(initial=0.0) else 0.0


def _gaussian(x: Samples, at: Samples, scale: float) -> Samples:
    made = _squares(x, at)
    made *= -scale
    return np.asarray(np.exp(made, out=made))


def _in_few(weights: Samples, kernel: Samples) -> tuple[Samples, Samples]:
    """Weights (c, q) by those directions of what they predict, `kernel` (n, c) times them, that hold all but `LEFT_OUT` of its variance:
    (c, r) and (r, q)."""
    predicted = kernel @ weights
    _, size, directions = np.linalg.svd(predicted, full_matrices=False)
    share = np.cumsum(size**2) / max(float(np.sum(size**2)), 1e-300)
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
