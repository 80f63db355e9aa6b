"""A mesh model for a performer of other proportions and another way of moving (thesis 9.3.2, equations 9.8 to 9.10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from kinegraph.operators.steering.model.fit import Steering, headings, turned
from kinegraph.operators.steering.model.graph_ranges import graph_matched, limb_angles
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
from kinegraph.operators.steering.model.regression import Regression, learn
from kinegraph.stream.chunk import Samples, Times

Ranges: TypeAlias = Literal["positions", "graph"]
RANGES: tuple[Ranges, ...] = get_args(Ranges)
Pairing: TypeAlias = Literal["nearest", "swing"]
PAIRINGS: tuple[Pairing, ...] = get_args(Pairing)
MAX_FRAMES = 300
NEAR = 3.0
"""No performed marker is taken to lie farther than this many standard deviations from its mean."""


def limb_frames(performed: Samples, mesh: Samples) -> Times:
    """For each performed frame the mesh's frame with the most similar change of angle (equation 9.9): (n,) for angles (n,) and (f,).

    Angles are in rad, their changes are forward differences, the last as the one before; a change in the other direction
    costs a standard deviation of `performed`.
    """
    a, b = _ahead(performed)[:, None], _ahead(mesh)[None]
    cost = np.abs(a - b) + 0.5 * float(performed.std()) * (1.0 - np.sign(a * b))
    return np.asarray(cost.argmin(axis=1), np.int64)


def nearest_frames(performed: Samples, mesh: Samples) -> Times:
    """For each performed frame (n, m, 3) the frame of the mesh (f, m, 3) with the nearest markers by sum of squares (9.10)."""
    cost = ((performed[:, None] - mesh[None]) ** 2).sum(axis=(2, 3))
    return np.asarray(cost.argmin(axis=1), np.int64)


def matched(performed: Samples, mesh: Samples) -> Samples:
    """Performed markers (n, m, 3) in the range of the mesh's (f, m, 3): each axis of each marker gets its mean and its variance."""
    spread = np.maximum(performed.std(axis=0), 1e-9)
    z = np.clip((performed - performed.mean(axis=0)) / spread, -NEAR, NEAR)
    return np.asarray(mesh.mean(axis=0) + z * mesh.std(axis=0))


def adapt(
    model: Steering,
    mesh: Samples,
    performed: Samples,
    heading: Sequence[str] = (),
    ranges: Ranges = "positions",
    pairing: Pairing = "nearest",
    graph: MarkerGraph | None = None,
) -> Steering:
    """`model` for the markers of a performer: where these were in `performed` (n, m, 3), the mesh is as in the frame that fits them.

    mesh      (f, m, 3)  the marked vertices in the frames that `model` was learned from
    heading   two markers, from the one to the other of which both face, where the model does not say

    The performed markers are brought into the ranges of the mesh's; then a part that follows one limb takes the frame in which this limb
    is nearest and swings in the same direction, and any other part the frame nearest in all markers. 9.9 as printed compares changes
    alone, which several frames of a stride share; so the sum of its cost and of the distance is taken, both in standard deviations.
    With the `pairing` of `swing` the limb's frames are those of 9.9 alone, by the angles of a `graph`, as printed.

    Of `ranges` positions are axes of each marker; `graph` are the angles and lengths of a `graph` of the mesh's markers, from which places
    follow by inverse kinematics, as in the thesis.

    Distances that the performer covers are scaled by the mean distance of the markers from their reference.
    """
    if len(performed) > MAX_FRAMES:
        performed = performed[np.linspace(0, len(performed) - 1, MAX_FRAMES).astype(int)]
    facing = model.facing
    if heading and not len(facing):
        pair = [model.markers.index(name) for name in heading]
        edge = (mesh[:, pair[1]] - mesh[:, pair[0]])[:, [0, 2]].mean(axis=0)
        facing = np.array([*pair, *(edge / max(float(np.linalg.norm(edge)), 1e-12))])
    x_mesh = model.features(mesh)[0]
    seen, theirs = about(model, performed, facing), about(model, mesh, facing)
    ranged = matched(seen, theirs)
    if graph and ranges == "graph":
        ranged = graph_matched(graph, seen, theirs, model.reference)
    x_mesh = model.pose(x_mesh)
    model = replace(model, graph=model.graph.of(seen) if model.graph else None)
    x, whole = model.pose(seen.reshape(len(seen), -1)), nearest_frames(ranged, theirs)
    parts = []
    for part in model.parts:
        limb = model.alone(part)
        frames = whole
        if limb and graph and pairing == "swing":
            one, other = (limb_angles(graph, marks, model.markers.index(limb)) for marks in (ranged, theirs))
            frames = limb_frames(one, other)
        elif limb:
            frames = _of_limb(ranged, theirs, model.markers.index(limb))
        regression: Regression = "linear" if part.learned.linear else "kernel"
        learned = learn(x[:, part.features], part.learned(x_mesh[frames][:, part.features]), regression)
        parts.append(replace(part, learned=learned))
    mean = seen.mean(axis=0)
    reach = float(np.linalg.norm(theirs.mean(axis=0), axis=1).mean() / max(np.linalg.norm(mean, axis=1).mean(), 1e-9))
    model = replace(model, soft=np.zeros((0, 0)), most=0.0)  # these markers lie on another body
    model = replace(model, settling=model.settling.without_markers() if model.settling else None)
    return replace(model, parts=tuple(parts), usual=mean, spread=seen.std(axis=0), facing=facing, reach=reach)


def about(model: Steering, marks: Samples, facing: Samples) -> Samples:
    """Markers (n, m, 3) as seen from the references' mean, all facing one way."""
    centre = marks[:, model.reference].mean(axis=1, keepdims=True)
    return turned(marks - centre, headings(marks, facing) * [1.0, -1.0]) if len(facing) else marks - centre


def _of_limb(performed: Samples, mesh: Samples, limb: int) -> Times:
    """The mesh's frame for each performed one, by the place and the swing of one limb's marker."""
    a, b = performed[:, limb], mesh[:, limb]
    spread = max(float(np.sqrt(((b - b.mean(axis=0)) ** 2).sum(axis=1).mean())), 1e-9)
    apart = np.linalg.norm(a[:, None] - b[None], axis=-1) / spread
    swing, swung = _change(_angle(a)), _change(_angle(b))
    swing, swung = (swing / max(swing.std(), 1e-9))[:, None], (swung / max(swung.std(), 1e-9))[None]
    cost = apart + np.abs(swing - swung) + 0.5 * (1.0 - np.sign(swing * swung))
    return np.asarray(cost.argmin(axis=1), np.int64)


def _angle(limb: Samples) -> Samples:
    """The angle (n,) rad of a limb (n, 3), seen from the reference, in the vertical plane in which it swings most."""
    flat = limb[:, [0, 2]] - limb[:, [0, 2]].mean(axis=0)
    along = np.linalg.svd(flat, full_matrices=False)[2][0]
    along = along * np.sign(along[np.abs(along).argmax()])
    return np.asarray(np.arctan2(flat @ along, np.maximum(-limb[:, 1], 1e-9)))


def _ahead(angle: Samples) -> Samples:
    """Forward differences, the last as the one before."""
    change = np.diff(angle, append=angle[-1:])
    if len(change) > 1:
        change[-1] = change[-2]
    return change


def _change(angle: Samples) -> Samples:
    """Backward differences, the first as the second."""
    change = np.diff(angle, prepend=angle[:1])
    if len(change) > 1:
        change[0] = change[1]
    return change
