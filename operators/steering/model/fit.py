"""From a moving mesh and the vertices that markers stand for: the part model, or the mesh straight from markers (thesis 9.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from kinegraph.operators.steering.model.limb_paths import limb_paths, shared_weights
from kinegraph.operators.steering.model.part import Part
from kinegraph.operators.steering.model.parts import blend_weights, edges_of, near_rigid_parts, nearest_of, seams_of
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph, backward
from kinegraph.operators.steering.model.regression import Learned, Regression, learn
from kinegraph.operators.steering.model.settling import Settling, SoftShapes
from kinegraph.operators.steering.model.skeleton import joint_of, posed, quaternions, tree_of
from kinegraph.operators.steering.model.soft import faded, pulls
from kinegraph.operators.steering.model.turns import matrix, rigid
from kinegraph.stream.chunk import Array, Samples, Times

REACH = 0.024
"""How far parts blend into one another, in diagonals of the mesh."""
FITS = 5
KEPT = 1e-4
"""What a regression straight to the vertices gives up for speed, in diagonals (root mean square)."""


NOTHING = Learned(*(np.zeros((0, 0)),) * 2, np.zeros(0), 1.0, 0.0, 0.0, 0.0)
"""Not learned yet."""


@dataclass(frozen=True, slots=True)
class PoseRegression:
    """How markers are turned into poses: what tells the pose (None: positions), the regression, and whether parts hang from one another;
    whether they are placed by their borders, how their shapes are moved (None: not), and whether limbs share clusters."""

    graph: MarkerGraph | None = None
    regression: Regression = "kernel"
    skeleton: bool = False
    greedy: bool = False
    shapes: SoftShapes | None = None
    shared: bool = False

    @property
    def settled(self) -> bool:
        """Whether parts are brought to fit one another after they were predicted."""
        return self.greedy or self.shapes is not None


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
    graph          the graph with the angles and lengths that define the pose; None if the markers' positions do
    settling       what brings the parts to fit one another; None where they stay as predicted
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
    settling: Settling | None = None

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
        features = self.pose(x, None if earlier is None else self.features(earlier)[0])
        made = np.zeros((len(marks), count, 3))
        predicted: list[Samples] = []
        seen_by = [self._seen(part, x, features) for part in self.parts]
        for part, (own, placed) in zip(self.parts, seen_by, strict=True):
            y = part.learned(own)
            y = np.hstack([placed, y[:, 9:]]) if part.frame else y
            if part.parent >= 0:
                above, sizes = predicted[part.parent], (len(self.parts[part.parent].vertices), len(part.vertices))
                roots = (sizes[0] ** 0.5, sizes[1] ** 0.5)
                y = np.array(
                    [posed(a, b, matrix(b[:6]), (part.above, part.own), roots) for a, b in zip(y, above, strict=True)]
                )
            predicted.append(y)
        for f, seen in enumerate(x.reshape(len(x), -1, 3)):
            far = max(part.learned.outside(own[f]) for part, (own, _) in zip(self.parts, seen_by, strict=True))
            ys = [y[f] for y in predicted]
            if self.settling:
                ys = self.settling(ys, seen, faded(far))
            for part, y in zip(self.parts, ys, strict=True):
                shape = part.mean + (y[9:] * np.sqrt(len(part.vertices)) @ part.modes).reshape(-1, 3)
                made[f, part.vertices] += part.weights[:, None] * (shape @ matrix(y[:6]).T + y[6:9])
            if len(self.soft):
                made[f] += pulls(seen - made[f, self.vertices], self.soft, self.most, faded(far))
        return turned(made, turns) + centre

    def outside(self, marks: Samples, enough: float = np.inf) -> float:
        """How far markers (1, m, 3) that stand still are from the training, in kernel widths, the largest of all parts; or the first that
        is larger than `enough`."""
        x = self.features(marks)[0]
        features, far = self.pose(x), 0.0
        for part in self.parts:
            far = max(far, part.learned.outside(self._seen(part, x, features)[0][0]))
            if far > enough:
                break
        return far

    def _seen(self, part: Part, x: Samples, features: Samples) -> tuple[Samples, Samples]:
        """A part's features, and, if it moves with a frame of markers, that frame's turn and place (f, 9)."""
        if part.frame is None:
            return features[:, part.features], np.zeros((len(x), 0))
        turns, middles, own = part.frame(x.reshape(len(x), -1, 3))
        return own, np.hstack([turns[:, :, 0], turns[:, :, 1], middles])


def headings(marks: Samples, facing: Samples) -> Samples:
    """How far markers (f, m, 3) are turned about the vertical from what a training faced: cosine and sine (f, 2)."""
    if not len(facing):
        return np.tile([1.0, 0.0], (len(marks), 1))
    edge = (marks[:, int(facing[1])] - marks[:, int(facing[0])])[:, [0, 2]]
    a, b = edge.T
    c, s = facing[2] * a + facing[3] * b, facing[3] * a - facing[2] * b
    return np.asarray(np.stack([c, s], axis=1) / np.maximum(np.hypot(c, s), 1e-12)[:, None])


def turned(points: Samples, turns: Samples) -> Samples:
    """`points` (f, n, 3) turned about the vertical, y, by the angles with cosine and sine `turns` (f, 2)."""
    c, s = turns[:, :1], turns[:, 1:]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([c * x + s * z, y, c * z - s * x], axis=-1)


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

    reference  the markers with the mesh's place as mean
    limbs      markers that alone drive the parts nearest to them, so that limbs can move as they never did together; the other parts,
               and all parts without limbs, follow all markers
    heading    two markers, from the one to the other of which the mesh faces, so that it may turn (y is up)
    earlier    (f, m, 3) where the markers were a frame before each; left out: the frames come one after the other
    """
    bare, points, x = untrained(frames, markers, reference, heading, how, earlier)
    layout = layout or Layout.of(frames, faces, bare.vertices, count)
    edges = np.concatenate([edges_of(faces), seams_of(frames)]) if how != USUAL else np.zeros((0, 2), np.int64)
    made, poses, clusters = list[Part](), list[Samples](), list[int]()
    for k, members in enumerate(_members(bare, layout, limbs, edges, points[0], shared=how.shared)):
        share = (layout.weights * (layout.parts == k)).sum(axis=1)
        there = share > 0.0
        if how.settled:
            there[edges[(layout.part[edges] == k).any(axis=1)]] = True
        vertices = np.flatnonzero(there)
        for features, weights in members:
            part, pose = _part(points[:, vertices], vertices, (share * weights)[vertices], modes, features)
            made.append(part)
            poses.append(pose)
            clusters.append(k)
    if how.skeleton:
        made, poses = hung(
            made, poses, int(layout.part[bare.vertices[bare.reference[0]]]), points, layout.part[edges], edges
        )
        clusters = list(range(len(made)))
    if how.settled:
        diagonal = float(np.linalg.norm(np.ptp(points[0], axis=0)))
        made, poses, settling = _settling(bare, made, poses, clusters, how, diagonal)
        bare = replace(bare, settling=settling)
    learned = (learn(x[:, part.features], y, how.regression) for part, y in zip(made, poses, strict=True))
    return replace(bare, parts=tuple(replace(part, learned=one) for part, one in zip(made, learned, strict=True)))


def _members(
    bare: Steering, layout: Layout, limbs: Sequence[str], edges: Times, rest: Samples, *, shared: bool
) -> list[list[tuple[Times, Samples | float]]]:
    """For each cluster, by which of the features its part goes, and how much of it counts (v,): one part, or, of a `shared` one, one for
    each limb."""
    names, every = bare.markers, np.arange(bare.width)
    count = int(layout.part.max()) + 1
    ends = [int(bare.vertices[names.index(limb)]) for limb in limbs]
    body = [int(v) for name, v in zip(names, bare.vertices, strict=True) if name not in limbs]
    paths = limb_paths(layout.part, edges, rest, ends, body) if shared else [[] for _ in limbs]
    found: list[list[tuple[Times, Samples | float]]] = []
    for k in range(count):
        on = [i for i, path in enumerate(paths) if k in path]
        owner = names[int(np.bincount(layout.nearest[layout.part == k], minlength=len(names)).argmax())]
        if len(on) > 1:
            weights = shared_weights(layout.part, k, edges, rest, [paths[i] for i in on], [ends[i] for i in on])
            found.append([(bare.own(limbs[i]), one) for i, one in zip(on, weights, strict=True)])
            continue
        owner = limbs[on[0]] if on else owner
        alone = owner in limbs and len(bare.own(owner)) > 0
        found.append([(bare.own(owner) if alone else every, 1.0)])
    return found


def _settling(
    bare: Steering, parts: list[Part], poses: list[Samples], clusters: list[int], how: PoseRegression, diagonal: float
) -> tuple[list[Part], list[Samples], Settling]:
    """Parts, and what their regressions are to learn, in the order of the greedy alignment, and what holds them together.

    Where shapes are moved and limbs are named, the body's are learned as the mean shape: the thesis has no prediction for them either.
    """
    if not how.skeleton:
        names = [bare.alone(part) for part in parts]
        touch = np.zeros((len(parts), len(parts)), np.int64)
        for a, b in combinations(range(len(parts)), 2):
            copies = clusters.count(clusters[a]) > 1 or clusters.count(clusters[b]) > 1
            if clusters[a] != clusters[b] and not (
                copies and None not in (names[a], names[b]) and names[a] != names[b]
            ):
                touch[a, b] = touch[b, a] = len(np.intersect1d(parts[a].vertices, parts[b].vertices))
        order, _ = tree_of(touch, int(np.argmax([len(part.vertices) for part in parts])))
        parts, poses, clusters = [parts[k] for k in order], [poses[k] for k in order], [clusters[k] for k in order]
    limbs = [bare.alone(part) for part in parts]
    spread = [pose[:, 9:].var(axis=0) for pose in poses]
    settling = Settling.of(parts, clusters, limbs, bare.vertices, spread, how.greedy)
    if how.shapes:
        settling = settling.by(how.shapes, diagonal)
        if any(limbs):
            poses = [
                pose if limb else np.hstack([pose[:, :9], np.zeros_like(pose[:, 9:])])
                for pose, limb in zip(poses, limbs, strict=True)
            ]
    return parts, poses, settling


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
    features = bare.pose(x, None if earlier is None else bare.features(earlier)[0])
    return replace(bare, usual=seen.mean(axis=0), spread=seen.std(axis=0)), points, features


def _part(points: Samples, vertices: Times, weights: Samples, modes: int, features: Times) -> tuple[Part, Samples]:
    """Mean shape and modes of a part with vertices at `points` (f, n, 3), not yet learned; and its poses and shapes (f, 9 + k)."""
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
