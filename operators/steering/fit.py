"""From a moving mesh and the vertices that markers stand for: the part model, or the mesh straight from markers (thesis 9.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from operators.steering.parts import blend_weights, edges_of, near_rigid_parts, nearest_of, seams_of
from operators.steering.pose_parameters import MarkerGraph, backward
from operators.steering.regression import Learned, Regression, learn
from operators.steering.skeleton import joint_of, posed, quaternions, tree_of
from operators.steering.soft import faded, pulls
from stream.chunk import Array, Samples, Times

REACH = 0.024
"""How far parts blend into one another, in diagonals of the mesh."""
FITS = 5
KEPT = 1e-4
"""What a regression straight to the vertices gives up for speed, in diagonals (root mean square)."""


NOTHING = Learned(*(np.zeros((0, 0)),) * 2, np.zeros(0), 1.0, 0.0, 0.0, 0.0)
"""Not learned yet."""


@dataclass(frozen=True, slots=True)
class Part:
    """A near-rigid part: its vertices, their weights, mean shape about its centre (n, 3), modes (k, 3 n), size; and its regression.

    features  which of all features it goes by
    parent    the part from which it hangs; -1: none, it is placed by itself
    above, own (1 + k, 3)  the virtual joint in the parent's frame and in its own, and how each mode moves it; (0, 3) without a parent
    """

    vertices: Times
    weights: Samples
    mean: Samples
    modes: Samples
    size: float
    features: Times
    learned: Learned
    parent: int = -1
    above: Samples = field(default_factory=lambda: np.zeros((0, 3)))
    own: Samples = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, slots=True)
class PoseRegression:
    """How markers are turned into poses: what tells the pose (None: positions), the regression, and whether parts hang from one another."""

    graph: MarkerGraph | None = None
    regression: Regression = "kernel"
    skeleton: bool = False


USUAL = PoseRegression()


@dataclass(frozen=True, slots=True)
class Steering:
    """What has been learned of a mesh: markers (names and vertices), those that its place goes by, and its parts.

    usual, spread  (m, 3)  where the markers were in the mean, from the references' mean, and by what standard deviation they moved
    facing         (4,)    two markers, and the horizontal direction (x, z) from the one to the other that the training faced; (0,) where
                           the mesh never turns as a whole
    reach          how far the mesh goes for a metre of its reference markers
    soft, most     (vertices, m), m  how much each vertex moves for what each marker's vertex is off by, and by what most of that; (0, 0)
                   where markers are no soft constraints
    graph          the graph by whose angles and lengths the markers tell the pose; None where their positions do
    """

    markers: tuple[str, ...]
    vertices: Times
    reference: Times
    parts: tuple[Part, ...]
    usual: Samples
    spread: Samples
    facing: Samples
    reach: float = 1.0
    soft: Samples = field(default_factory=lambda: np.zeros((0, 0)))
    most: float = 0.0
    graph: MarkerGraph | None = None

    @property
    def width(self) -> int:
        """How many numbers tell a pose."""
        return self.graph.width if self.graph else 3 * len(self.markers)

    def own(self, marker: str) -> Times:
        """Which of the numbers that tell a pose are a marker's own, so that what goes by them alone follows it alone."""
        k = self.markers.index(marker)
        return self.graph.limb(k) if self.graph else 3 * k + np.arange(3)

    def alone(self, part: Part) -> str | None:
        """The one marker that a part goes by; None where it goes by all."""
        if len(part.features) == self.width:
            return None
        return next((one for one in self.markers if np.array_equal(self.own(one), part.features)), None)

    def pose(self, x: Samples, earlier: Samples | None = None) -> Samples:
        """The numbers that tell the pose (f, width), of markers as `features` gives them, x (f, 3 m), and a frame `earlier` (f, 3 m).

        Left out: the frames are taken to come one after the other.
        """
        if self.graph is None:
            return x
        seen = x.reshape(len(x), -1, 3)
        return self.graph(seen, backward(seen) if earlier is None else earlier.reshape(seen.shape))

    def features(self, marks: Samples) -> tuple[Samples, Samples, Samples]:
        """Markers (f, m, 3) as seen from the references' mean and turned to face as in the training: (f, 3 m); that mean (f, 1, 3); and
        the turns (f, 2), cosine and sine."""
        centre = marks[:, self.reference].mean(axis=1, keepdims=True)
        turns = headings(marks, self.facing)
        return turned(marks - centre, turns * [1.0, -1.0]).reshape(len(marks), -1), centre * self.reach, turns

    def __call__(self, marks: Samples, count: int, earlier: Samples | None = None) -> Samples:
        """The mesh (f, count, 3) for markers (f, m, 3) that were elsewhere `earlier`: the slow reference of the operator's kernel."""
        x, centre, turns = self.features(marks)
        told = self.pose(x, None if earlier is None else self.features(earlier)[0])
        made = np.zeros((len(marks), count, 3))
        predicted: list[Samples] = []
        for part in self.parts:
            y = part.learned(told[:, part.features])
            if part.parent >= 0:
                above, sizes = predicted[part.parent], (len(self.parts[part.parent].vertices), len(part.vertices))
                roots = (sizes[0] ** 0.5, sizes[1] ** 0.5)
                y = np.array(
                    [posed(a, b, matrix(b[:6]), (part.above, part.own), roots) for a, b in zip(y, above, strict=True)]
                )
            predicted.append(y)
            for f in range(len(marks)):
                shape = part.mean + (y[f, 9:] * np.sqrt(len(part.vertices)) @ part.modes).reshape(-1, 3)
                made[f, part.vertices] += part.weights[:, None] * (shape @ matrix(y[f, :6]).T + y[f, 6:9])
        for f, seen in enumerate(x.reshape(len(x), -1, 3) if len(self.soft) else ()):
            far = max(part.learned.outside(told[f, part.features]) for part in self.parts)
            made[f] += pulls(seen - made[f, self.vertices], self.soft, self.most, faded(far))
        return turned(made, turns) + centre


def headings(marks: Samples, facing: Samples) -> Samples:
    """How far markers (f, m, 3) are turned about the vertical from what a training faced: cosine and sine (f, 2)."""
    if not len(facing):
        return np.tile([1.0, 0.0], (len(marks), 1))
    edge = (marks[:, int(facing[1])] - marks[:, int(facing[0])])[:, [0, 2]]
    a, b = edge.T
    c, s = facing[2] * a + facing[3] * b, facing[3] * a - facing[2] * b
    return np.asarray(np.stack([c, s], axis=1) / np.maximum(np.hypot(c, s), 1e-12)[:, None])


def turned(points: Samples, turns: Samples) -> Samples:
    """`points` (f, n, 3) turned about the vertical, y, by the angles whose cosine and sine are `turns` (f, 2)."""
    c, s = turns[:, :1], turns[:, 1:]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([c * x + s * z, y, c * z - s * x], axis=-1)


def matrix(six: Samples) -> Samples:
    """The rotation matrix (3, 3) nearest to two columns (6,)."""
    a = six[:3] / max(float(np.linalg.norm(six[:3])), 1e-12)
    b = six[3:] - a * (a @ six[3:])
    b = b / max(float(np.linalg.norm(b)), 1e-12)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def rigid(a: Samples, b: Samples) -> tuple[Samples, Samples]:
    """The rotation (3, 3) and translation (3,) that bring the points `a` (n, 3) onto `b` best: b ~ a R^T + t (Gower 1975)."""
    ca, cb = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((a - ca).T @ (b - cb))
    turn = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return turn.T, cb - turn.T @ ca


@dataclass(frozen=True, slots=True)
class Layout:
    """Which part each vertex is of, the parts that blend there and by what weights, and the marker nearest to it."""

    part: Times
    parts: Times
    weights: Samples
    nearest: Times

    @staticmethod
    def of(frames: Samples, faces: Array, at: Times, count: int) -> Layout:
        edges = np.concatenate([edges_of(faces), seams_of(frames)])
        part = near_rigid_parts(frames, edges, count)
        diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))
        return Layout(part, *blend_weights(part, edges, frames[0], REACH * diagonal), nearest_of(at, edges, frames[0]))


def fit_steering(
    frames: Samples,
    faces: Array,
    markers: Mapping[str, int],
    reference: Sequence[str],
    limbs: Sequence[str] = (),
    count: int = 14,
    modes: int = 4,
    heading: Sequence[str] = (),
    layout: Layout | None = None,
    how: PoseRegression = USUAL,
    earlier: Samples | None = None,
) -> Steering:
    """Learn how a mesh's `frames` (f, vertices, 3) follow from the vertices that `markers` names.

    reference  the markers whose mean is where the mesh is
    limbs      markers that alone drive the parts nearest to them, so that limbs can move as they never did together; the other parts,
               and all where none are named, go by all markers
    heading    two markers, from the one to the other of which the mesh faces, so that it may turn (y is up)
    earlier    (f, m, 3) where the markers were a frame before each; left out: the frames come one after the other
    """
    bare, points, x = untrained(frames, markers, reference, heading, how, earlier)
    layout = layout or Layout.of(frames, faces, bare.vertices, count)
    made, poses, names = list[Part](), list[Samples](), bare.markers
    for k in range(int(layout.part.max()) + 1):
        owner = names[int(np.bincount(layout.nearest[layout.part == k], minlength=len(names)).argmax())]
        alone = owner in limbs and len(bare.own(owner)) > 0
        features = bare.own(owner) if alone else np.arange(x.shape[1])
        share = (layout.weights * (layout.parts == k)).sum(axis=1)
        vertices = np.flatnonzero(share > 0.0)
        part, pose = _part(points[:, vertices], vertices, share[vertices], modes, features)
        made.append(part)
        poses.append(pose)
    if how.skeleton:
        edges = np.concatenate([edges_of(faces), seams_of(frames)])
        made, poses = hung(
            made, poses, int(layout.part[bare.vertices[bare.reference[0]]]), points, layout.part[edges], edges
        )
    learned = (learn(x[:, part.features], y, how.regression) for part, y in zip(made, poses, strict=True))
    return replace(bare, parts=tuple(replace(part, learned=one) for part, one in zip(made, learned, strict=True)))


def hung(
    parts: Sequence[Part], poses: Sequence[Samples], root: int, points: Samples, owners: Times, edges: Times
) -> tuple[list[Part], list[Samples]]:
    """Parts as a virtual skeleton, each after its parent, and what their regressions are to learn: the pose of the root as it is, of
    any other part the quaternion (4,) that turns it against its parent, five zeros, and its shape.

    points         (f, vertices, 3)  the frames
    owners, edges  (m, 2)            the mesh's edges, and of which part their ends are

    Departs from table 9.1: the quaternion is that between two clusters, not between two edges of the path of joints, which say nothing
    of how a limb twists. A part hangs from its parent by the joint, so that no place is learned.
    """
    shared = np.zeros((len(parts), len(parts)), np.int64)
    np.add.at(shared, (owners, owners[:, ::-1]), 1)
    np.fill_diagonal(shared, 0)
    order, parents = tree_of(shared, root)
    turns = [np.array([matrix(one) for one in poses[k][:, :6]]) for k in order]
    hanging, learned = list[Part](), list[Samples]()
    for place, (k, parent) in enumerate(zip(order, parents, strict=True)):
        part, pose = parts[k], poses[k]
        if parent >= 0:
            up = order[parent]
            border = edges[(np.sort(owners, axis=1) == sorted((k, up))).all(axis=1)]
            joint = points[:, np.unique(border)].mean(axis=1)
            above = joint_of(joint, turns[parent], poses[up], len(parts[up].vertices))
            own = joint_of(joint, turns[place], pose, len(part.vertices))
            part = replace(part, parent=parent, above=above, own=own)
            local = quaternions(turns[parent].transpose(0, 2, 1) @ turns[place])
            pose = np.hstack([2.0 * part.size * local, np.zeros((len(pose), 5)), pose[:, 9:]])
        hanging.append(part)
        learned.append(pose)
    return hanging, learned


def fit_straight(
    frames: Samples,
    markers: Mapping[str, int],
    reference: Sequence[str],
    heading: Sequence[str] = (),
    how: PoseRegression = USUAL,
    earlier: Samples | None = None,
) -> Steering:
    """The same without parts: regression from all markers straight to the vertices, as one part that is never turned, by as many
    principal components as keep every frame within `KEPT` of the mesh's diagonal."""
    bare, points, x = untrained(frames, markers, reference, heading, how, earlier)
    mean = points.mean(axis=0)
    _, size, directions = np.linalg.svd((points - mean).reshape(len(points), -1), full_matrices=False)
    left = np.sqrt(np.append(np.cumsum(size[::-1] ** 2)[::-1], 0.0) / points[..., 0].size)
    kept = int(np.argmax(left <= KEPT * np.linalg.norm(np.ptp(mean, axis=0))))
    basis = directions[:kept]
    coefficients = (points - mean).reshape(len(points), -1) @ basis.T / np.sqrt(len(mean))
    still = np.tile([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], (len(points), 1))
    every, all_of_it = np.arange(x.shape[1]), np.arange(len(mean))
    learned = learn(x, np.hstack([still, coefficients]), how.regression)
    return replace(bare, parts=(Part(all_of_it, np.ones(len(mean)), mean, basis, 1.0, every, learned),))


def untrained(
    frames: Samples,
    markers: Mapping[str, int],
    reference: Sequence[str],
    heading: Sequence[str],
    how: PoseRegression = USUAL,
    earlier: Samples | None = None,
) -> tuple[Steering, Samples, Samples]:
    """A model without parts; the frames (f, vertices, 3) about its reference, all facing one way; and what tells their poses (f, width)."""
    names, at = tuple(markers), np.array(list(markers.values()), np.int64)
    body = np.array([names.index(name) for name in reference], np.int64)
    facing = np.zeros(0)
    if heading:
        pair = [names.index(name) for name in heading]
        edge = (frames[:, at[pair[1]]] - frames[:, at[pair[0]]])[:, [0, 2]].mean(axis=0)
        facing = np.array([*pair, *(edge / max(float(np.linalg.norm(edge)), 1e-12))])
    bare = Steering(names, at, body, (), np.zeros((len(at), 3)), np.zeros((len(at), 3)), facing, graph=how.graph)
    x, centre, turns = bare.features(frames[:, at])
    seen = x.reshape(len(x), -1, 3)
    points = turned(frames - centre, turns * [1.0, -1.0]) if heading else frames - centre
    told = bare.pose(x, None if earlier is None else bare.features(earlier)[0])
    return replace(bare, usual=seen.mean(axis=0), spread=seen.std(axis=0)), points, told


def _part(points: Samples, vertices: Times, weights: Samples, modes: int, features: Times) -> tuple[Part, Samples]:
    """Mean shape and modes of a part whose vertices are at `points` (f, n, 3), not yet learned; and its poses and shapes (f, 9 + k)."""
    mean = points[0]
    for _ in range(FITS):
        fits = [rigid(frame, mean) for frame in points]
        mean = np.mean([frame @ turn.T + move for frame, (turn, move) in zip(points, fits, strict=True)], axis=0)
    centre = mean.mean(axis=0)
    mean = mean - centre
    poses = [rigid(mean, frame) for frame in points]
    shapes = np.array([(frame - move) @ turn for frame, (turn, move) in zip(points, poses, strict=True)]) - mean
    _, _, directions = np.linalg.svd(shapes.reshape(len(points), -1), full_matrices=False)
    basis = directions[:modes]
    size = float(np.sqrt((mean**2).sum(1).mean()))
    turns = np.array([turn[:, :2].T.ravel() for turn, _ in poses])
    moves = np.array([move for _, move in poses])
    coefficients = shapes.reshape(len(points), -1) @ basis.T / np.sqrt(len(vertices))
    return (
        Part(vertices, weights, mean, basis, size, features, NOTHING),
        np.hstack([turns * size, moves, coefficients]),
    )
