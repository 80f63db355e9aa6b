"""A pose by the angles and lengths of a graph of markers, and by the directions in which they move (thesis 9.3.1, table 9.1)."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from kinegraph.operators.steering.model.parts import along_surface, edges_of, seams_of
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel

PoseKind: TypeAlias = Literal["positions", "angles", "directions"]
POSES: tuple[PoseKind, ...] = get_args(PoseKind)
DIRECTED = 0.3
"""A direction weighs as much as this share of its marker's standard deviation."""
STILL = 0.1
"""A marker stands that goes less than this share of its median step in the training."""


@dataclass(frozen=True, slots=True)
class MarkerGraph:
    """The edges of markers that describe a pose, beside the reference edge.

    lead     (2,)    the markers of the reference edge, e_ref
    edges    (k, 2)  markers from, to; in such an order that the edge before stands earlier
    before   (k,)    which edge an edge's angle is measured against; -1: the reference edge
    lengths  (k,)    m, mean length of each edge: an angle is given as an arc of that radius, so that it compares with lengths
    shares   (k,)    m, what a direction weighs; 0 where directions are not used
    still    (k,)    m, how far a marker has to go in a frame to have a whole direction
    """

    lead: Times
    edges: Times
    before: Times
    lengths: Samples
    shares: Samples
    still: Samples

    @property
    def block(self) -> int:
        """How many numbers an edge has: angle and length, and the direction (3,) where it is used."""
        return 5 if self.shares.any() else 2

    @property
    def width(self) -> int:
        return self.block * len(self.edges)

    def path(self, marker: int) -> Times:
        """The numbers of the edges from the reference edge to a marker, which are its limb; () for a marker of the reference edge."""
        found: list[int] = []
        at = np.flatnonzero(self.edges[:, 1] == marker)
        while len(at) and at[0] >= 0:
            found.append(int(at[0]))
            at = self.before[at[:1]]
        return np.array(found[::-1], np.int64)

    def limb(self, marker: int) -> Times:
        """Which parameters tell the limb that ends in a marker."""
        return (self.path(marker)[:, None] * self.block + np.arange(self.block)).ravel()

    def of(self, seen: Samples) -> MarkerGraph:
        """The graph with the lengths and movements of the markers `seen` (f, m, 3) in a training."""
        moved = seen[:, self.edges[:, 1]]
        lengths = np.linalg.norm(moved - seen[:, self.edges[:, 0]], axis=-1).mean(axis=0)
        steps = np.linalg.norm(moved - backward(seen)[:, self.edges[:, 1]], axis=-1)
        shares = DIRECTED * np.sqrt(moved.var(axis=0).sum(axis=-1)) * (self.shares > 0.0)
        return replace(self, lengths=lengths, shares=shares, still=np.maximum(STILL * np.median(steps, axis=0), 1e-9))

    def __call__(self, marks: Samples, earlier: Samples) -> Samples:
        """The parameters (f, width) of markers (f, m, 3) that were `earlier` (f, m, 3): the slow reference of `tell_pose`."""
        first = (marks[:, self.lead[1]] - marks[:, self.lead[0]])[:, None]
        along = marks[:, self.edges[:, 1]] - marks[:, self.edges[:, 0]]
        against = np.concatenate([along, first], axis=1)[:, self.before]
        cross = np.linalg.norm(np.cross(against, along), axis=-1)
        angles = np.arctan2(cross, (against * along).sum(axis=-1)) * self.lengths
        features = np.stack([angles, np.linalg.norm(along, axis=-1)], axis=-1)
        if self.block == 5:
            step = (marks - earlier)[:, self.edges[:, 1]]
            step = step / np.maximum(np.linalg.norm(step, axis=-1), self.still)[..., None] * self.shares[:, None]
            features = np.concatenate([features, step], axis=-1)
        return np.asarray(features.reshape(len(marks), -1))


def backward(marks: Samples) -> Samples:
    """Where markers (f, m, 3) were a frame earlier; of the first, as if it moved as the second."""
    if len(marks) < 2:
        return marks
    return np.concatenate([2 * marks[:1] - marks[1:2], marks[:-1]])


def marker_graph(
    seen: Samples,
    frames: Samples,
    faces: Array,
    at: Times,
    lead: tuple[int, int],
    kind: PoseKind,
    ends: Collection[int] = (),
) -> MarkerGraph | None:
    """The graph of markers `seen` (f, m, 3) at the vertices `at` of a mesh; None where positions are to tell the pose.

    The reference edge joins the markers of `lead`; every other marker is joined to what is nearest along the surface, as the shortest tree
    has it, but for `ends`, from which no edge goes on: they move by themselves. The thesis lets its user draw the graph. A limb of one
    marker is an edge from the body, as there; one with a marker halfway has two.
    """
    if kind == "positions":
        return None
    apart = along_surface(at, np.concatenate([edges_of(faces), seams_of(frames)]), frames[0])[:, at]
    straight = np.linalg.norm(frames[0, at][:, None] - frames[0, at][None], axis=-1)
    apart = np.where(np.isfinite(apart), apart, 1e3 + straight)
    joined, edges = list(lead), list[tuple[int, int]]()
    rest = [k for k in range(len(at)) if k not in joined]
    while rest:
        i, j = np.unravel_index(apart[np.ix_(joined, rest)].argmin(), (len(joined), len(rest)))
        end = rest.pop(int(j))
        edges.append((joined[int(i)], end))
        joined += [end] if end not in ends else []
    last = [end for _, end in edges]
    pairs = np.array(edges, np.int64).reshape(-1, 2)
    before = np.array([last.index(start) if start in last else -1 for start, _ in edges], np.int64)
    nothing = np.zeros(len(pairs))
    weighs = np.full(len(pairs), float(kind == "directions"))
    return MarkerGraph(np.array(lead, np.int64), pairs, before, nothing, weighs, nothing).of(seen)


@kernel
def tell_pose(
    marks: Samples,
    earlier: Samples,
    lead: Times,
    edges: Times,
    before: Times,
    lengths: Samples,
    shares: Samples,
    still: Samples,
    out: Samples,
) -> None:
    """The parameters `out` (width,) of one sample's markers (m, 3), which were `earlier` (m, 3), by a `MarkerGraph`."""
    edge, against = np.empty(3), np.empty(3)
    block = out.shape[0] // max(edges.shape[0], 1)
    for k in range(edges.shape[0]):
        i, j, b = edges[k, 0], edges[k, 1], before[k]
        p, q = (lead[0], lead[1]) if b < 0 else (edges[b, 0], edges[b, 1])
        dot = long = step = cross = 0.0
        for a in range(3):
            edge[a] = marks[j, a] - marks[i, a]
            against[a] = marks[q, a] - marks[p, a]
            dot += edge[a] * against[a]
            long += edge[a] * edge[a]
            step += (marks[j, a] - earlier[j, a]) ** 2
        for a in range(3):
            c, d = (a + 1) % 3, (a + 2) % 3
            cross += (against[c] * edge[d] - against[d] * edge[c]) ** 2
        out[block * k] = lengths[k] * math.atan2(math.sqrt(cross), dot)
        out[block * k + 1] = math.sqrt(long)
        if block == 5:
            weight = shares[k] / max(math.sqrt(step), still[k])
            for a in range(3):
                out[block * k + 2 + a] = weight * (marks[j, a] - earlier[j, a])
