"""The virtual skeleton: a tree of near-rigid parts, each turned against its parent by a quaternion (thesis 9.3.1, 9.4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel


def tree_of(shared: Times, root: int) -> tuple[list[int], list[int]]:
    """The order in which parts are joined, and the place of each one's parent in that order, or -1.

    shared (k, k)  how many edges of the mesh go from one part to the other

    From the root on, the part that has the longest border with one that is joined already comes next: the order of the thesis's greedy
    alignment, which counts vertices in the overlap. A part without such a border begins a tree of its own.
    """
    order, parents = [root], [-1]
    while len(order) < len(shared):
        rest = [k for k in range(len(shared)) if k not in order]
        common = shared[np.ix_(order, rest)]
        i, j = np.unravel_index(common.argmax(), common.shape)
        parents.append(int(i) if common[i, j] else -1)
        order.append(rest[int(j)])
    return order, parents


def quaternions(turns: Samples) -> Samples:
    """Unit quaternions (f, 4), w first, of rotation matrices (f, 3, 3), all on the side of the first one's half."""
    found = np.empty((len(turns), 4))
    for f, m in enumerate(turns):
        four = np.array(
            [
                [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
                [0.0, m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
                [0.0, 0.0, m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
                [0.0, 0.0, 0.0, m[2, 2] - m[0, 0] - m[1, 1]],
            ]
        )
        found[f] = np.linalg.eigh(four + np.triu(four, 1).T)[1][:, -1]
        found[f] *= -1.0 if found[f] @ (found[0] if f else [1.0, 0.0, 0.0, 0.0]) < 0.0 else 1.0
    return found


def turn_of(q: Samples) -> Samples:
    """The rotation matrix (3, 3) of a quaternion (4,) of any length but 0."""
    w, x, y, z = np.asarray(q) / max(float(np.linalg.norm(q)), 1e-12)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def joint_of(joint: Samples, turns: Samples, poses: Samples, vertices: int) -> Samples:
    """A virtual joint in a part's own frame, (1 + modes, 3): where it is at the mean shape, and how each mode moves it.

    joint  (f, 3)          where it is: the barycentre of the vertices on both sides of a border
    turns  (f, 3, 3), poses (f, 9 + modes)  the part's rotations; its places and shapes   vertices  how many it has
    """
    local = np.einsum("fji,fj->fi", turns, joint - poses[:, 6:9])
    shapes = np.sqrt(vertices) * poses[:, 9:]
    mean, centred = local.mean(axis=0), shapes - shapes.mean(axis=0)
    ridge = 1e-6 * float((centred**2).sum()) + 1e-15
    moves = np.linalg.solve(centred.T @ centred + ridge * np.eye(shapes.shape[1]), centred.T @ (local - mean))
    return np.concatenate([(mean - shapes.mean(axis=0) @ moves)[None], moves])


def posed(y: Samples, parent: Samples, turn: Samples, joints: Sequence[Samples], roots: tuple[float, float]) -> Samples:
    """What a child's prediction `y` comes to where its parent's `turn` (3, 3) is known: the slow reference of `hang`."""
    above, own = joints
    mine = turn @ turn_of(y[:4])
    there = above[0] + roots[0] * parent[9:] @ above[1:]
    here = own[0] + roots[1] * y[9:] @ own[1:]
    return np.concatenate([mine[:, :2].T.ravel(), turn @ there + parent[6:9] - mine @ here, y[9:]])


@kernel
def hang(y: Samples, parent: Samples, turn: Samples, above: Samples, own: Samples, sizes: Times) -> None:
    """Turn a child's prediction `y` (9 + modes,), which begins with a quaternion, into its rotation's two columns and its place.

    parent  (9 + modes,)    the parent's prediction, in its final form   turn (3, 3) its rotation
    above, own (1 + modes, 3)  the joint in the parent's frame and in the child's   sizes (2,) how many vertices each has
    """
    n = max(math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3]), 1e-12)
    w, a, b, c = y[0] / n, y[1] / n, y[2] / n, y[3] / n
    local = np.empty((3, 3))
    local[0, 0], local[0, 1], local[0, 2] = 1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)
    local[1, 0], local[1, 1], local[1, 2] = 2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)
    local[2, 0], local[2, 1], local[2, 2] = 2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)
    there, here = above[0].copy(), own[0].copy()
    for m in range(above.shape[0] - 1):
        for i in range(3):
            there[i] += math.sqrt(sizes[0]) * parent[9 + m] * above[1 + m, i]
    for m in range(own.shape[0] - 1):
        for i in range(3):
            here[i] += math.sqrt(sizes[1]) * y[9 + m] * own[1 + m, i]
    for i in range(3):
        y[6 + i] = parent[6 + i]
        for j in range(3):
            y[6 + i] += turn[i, j] * there[j]
    for i in range(3):
        for j in range(3):
            v = turn[i, 0] * local[0, j] + turn[i, 1] * local[1, j] + turn[i, 2] * local[2, j]
            y[6 + i] -= v * here[j]
            if j < 2:
                y[3 * j + i] = v
