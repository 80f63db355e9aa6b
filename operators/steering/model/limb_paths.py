"""Which clusters of a mesh are of which limb, and how one that several limbs share is blended (thesis 9.3.1, 9.4.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from kinegraph.operators.steering.model.parts import along_surface
from kinegraph.stream.chunk import Samples, Times


def limb_paths(part: Times, edges: Times, rest: Samples, ends: Sequence[int], body: Sequence[int]) -> list[list[int]]:
    """For each limb its clusters, from that of its end to that of the body's marker nearest along the surface.

    part (v,) cluster of each vertex; edges (m, 2), rest (v, 3) of the mesh; ends, body  vertices of the limbs' markers and the others

    The shortest path goes through the fewest clusters; of equally many, through those with the nearest middles.
    """
    count = int(part.max()) + 1
    if not body:
        return [[int(part[end])] for end in ends]
    middles = np.array([rest[part == k].mean(axis=0) for k in range(count)])
    touching = np.unique(part[edges], axis=0)
    touching = touching[touching[:, 0] != touching[:, 1]]
    apart = np.linalg.norm(middles[touching[:, 0]] - middles[touching[:, 1]], axis=1)
    graph = csr_matrix((1.0 + 1e-3 * apart / max(float(np.ptp(rest, axis=0).max()), 1e-12), touching.T), (count, count))
    made = []
    for end in ends:
        along = along_surface(np.array([end]), edges, rest)[0][list(body)]
        _, before = dijkstra(graph, directed=False, indices=part[end], return_predecessors=True)
        path = [int(part[body[int(along.argmin())]])]
        while before[path[0]] >= 0:
            path.insert(0, int(before[path[0]]))
        made.append(path if path[0] == part[end] else [int(part[end])])
    return made


def shared_weights(
    part: Times, cluster: int, edges: Times, rest: Samples, paths: Sequence[list[int]], ends: Sequence[int]
) -> Samples:
    """How much each vertex of the mesh follows each limb that shares a cluster: (limbs, vertices), `blended` (9.16).

    paths, ends  clusters and end vertices of the limbs that share it. A limb's border is where the next cluster towards its end begins; of
    a limb that ends in the cluster it is the marker. What lies outside the cluster blends as the vertex of it that is nearest.
    """
    mine = np.flatnonzero(part == cluster)
    inside = edges[(part[edges] == cluster).all(axis=1)]
    both = np.concatenate([edges, edges[:, ::-1]])
    apart = []
    for path, end in zip(paths, ends, strict=True):
        at = path.index(cluster)
        border = both[(part[both[:, 0]] == cluster) & (part[both[:, 1]] == path[at - 1]), 0] if at else np.array([end])
        apart.append(along_surface(np.unique(border), inside, rest).min(axis=0)[mine])
    near = cKDTree(rest[mine]).query(rest)[1]
    return blended(np.array(apart))[:, near]


def blended(apart: Samples) -> Samples:
    """Weights (m, v) of m limbs at vertices with distances `apart` (m, v) to the limbs' borders, inf where they are not joined.

    Of two limbs they are as equation 9.16 prints them: (d1 + d2 - dl) / (d1 + d2). Of more, what is printed adds up to m - 1 rather than to
    1, and other limbs weigh at a limb's border. In its place stands w_l = prod(d_i, i != l), divided by the sum of these: the same for two,
    and of any number 1 at the limb's own border and 0 at the others'.
    """
    far = np.where(np.isfinite(apart), apart, 10.0 * np.max(apart, where=np.isfinite(apart), initial=1e-9))
    far = np.maximum(far / max(float(far.max()), 1e-12), 1e-9)
    weights = np.array([np.prod(np.delete(far, one, axis=0), axis=0) for one in range(len(far))])
    return np.asarray(weights / weights.sum(axis=0))
