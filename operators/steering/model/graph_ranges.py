"""Ranges of motion of a marker graph: angles and lengths get a mesh's means and variances, places follow by inverse kinematics (9.3.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
from kinegraph.stream.chunk import Samples, Times

NEAR = 3.0
"""No angle or length is taken to lie farther than this many standard deviations from its mean."""


@dataclass(frozen=True, slots=True)
class GraphAngles:
    """What a graph says of f frames of markers: angles (f, k) rad of its edges, their lengths (f, k), and the reference edge's (f, 1)."""

    angles: Samples
    lengths: Samples
    lead: Samples

    @staticmethod
    def of(graph: MarkerGraph, marks: Samples) -> GraphAngles:
        """Of markers (f, m, 3)."""
        k = len(graph.edges)
        plain = replace(graph, lengths=np.ones(k), shares=np.zeros(k))
        angles = plain(marks, marks).reshape(len(marks), k, 2)
        first = np.linalg.norm(marks[:, graph.lead[1]] - marks[:, graph.lead[0]], axis=-1)
        return GraphAngles(angles[..., 0], angles[..., 1], first[:, None])


def in_range(performed: Samples, mesh: Samples, least: Samples | float, most: float = np.inf) -> Samples:
    """Parameters (n, k) with the means and the variances of the mesh's (f, k), between `least` and `most`."""
    z = (performed - performed.mean(axis=0)) / np.maximum(performed.std(axis=0), 1e-9)
    return np.asarray(np.clip(mesh.mean(axis=0) + np.clip(z, -NEAR, NEAR) * mesh.std(axis=0), least, most))


def graph_matched(graph: MarkerGraph, performed: Samples, mesh: Samples, reference: Times) -> Samples:
    """Performed markers (n, m, 3) with angles and edge lengths scaled to the means and variances of the mesh's (f, m, 3): about the mean of
    the markers `reference`.

    The graph is a tree, so that inverse kinematics has one solution that meets all angles and lengths: from the reference edge on,
    every edge leaves the one before it by its angle, in the plane in which it was performed. No edge is shorter than ever in the mesh.
    """
    theirs, wanted = GraphAngles.of(graph, performed), GraphAngles.of(graph, mesh)
    angles = in_range(theirs.angles, wanted.angles, 0.0, np.pi)
    lengths = in_range(theirs.lengths, wanted.lengths, wanted.lengths.min(axis=0))
    first = in_range(theirs.lead, wanted.lead, wanted.lead.min(axis=0))
    made = np.zeros_like(performed)
    lead = _unit(performed[:, graph.lead[1]] - performed[:, graph.lead[0]])
    made[:, graph.lead[1]] = first * lead
    along: list[Samples] = []
    for k, (start, end) in enumerate(graph.edges):
        b = graph.before[k]
        was = lead if b < 0 else _unit(performed[:, graph.edges[b, 1]] - performed[:, graph.edges[b, 0]])
        now = lead if b < 0 else along[b]
        aside = _turned(was, now, _aside(was, performed[:, end] - performed[:, start]))
        along.append(np.cos(angles[:, k : k + 1]) * now + np.sin(angles[:, k : k + 1]) * aside)
        made[:, end] = made[:, start] + lengths[:, k : k + 1] * along[-1]
    return np.asarray(made - made[:, reference].mean(axis=1, keepdims=True))


def limb_angles(graph: MarkerGraph, marks: Samples, marker: int) -> Samples:
    """The angle (f,) rad between the reference edge and a limb, from where its path leaves the body to its `marker`."""
    path = graph.path(marker)
    start = int(graph.edges[path[0], 0]) if len(path) else int(graph.lead[0])
    first, limb = marks[:, graph.lead[1]] - marks[:, graph.lead[0]], marks[:, marker] - marks[:, start]
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(first, limb), axis=-1), (first * limb).sum(axis=-1)))


def _unit(v: Samples) -> Samples:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _aside(along: Samples, edge: Samples) -> Samples:
    """The direction (f, 3) in which `edge` leaves `along`; any perpendicular one where it goes straight on."""
    aside = edge - (edge * along).sum(axis=-1, keepdims=True) * along
    straight = np.linalg.norm(aside, axis=-1) < 1e-9 * np.maximum(np.linalg.norm(edge, axis=-1), 1e-12)
    axis = np.eye(3)[np.abs(along).argmin(axis=-1)]
    other = axis - (axis * along).sum(axis=-1, keepdims=True) * along
    return _unit(np.where(straight[:, None], other, aside))


def _turned(was: Samples, now: Samples, v: Samples) -> Samples:
    """`v` (f, 3) turned by the shortest turn that takes the directions `was` to `now`."""
    axis, cosine = np.cross(was, now), (was * now).sum(axis=-1, keepdims=True)
    along = axis * (axis * v).sum(axis=-1, keepdims=True) / np.maximum(1 + cosine, 1e-9)
    return np.asarray(v * cosine + np.cross(axis, v) + along)
