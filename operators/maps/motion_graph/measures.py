"""What a motion graph is worth: how much of the recordings it keeps, how much choice it gives, how soon it gets somewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.motion_graph import MotionGraph


@dataclass(frozen=True, slots=True)
class Measures:
    """nodes; core: those in it; edges: of the core, without the recordings' own; coverage: share of the recorded time of nodes in the core;
    branching: edges out of a core node, mean; clusters: in the core; reach_s: from the end of a core node to the start of a node of each
    other cluster (-1: transitions are no goals), median and 95th percentile."""

    nodes: int
    core: int
    edges: int
    coverage: float
    branching: float
    clusters: int
    reach_s: tuple[float, float]


def travel_s(graph: MotionGraph) -> Samples:
    """(k, clusters) seconds from the end of each node to the first node of each cluster, along the core; inf: it is not reached."""
    k, inner = len(graph.first), graph.core[graph.source] & graph.core[graph.target]
    lasts = (graph.last - graph.first) / graph.rate_hz
    source, target = np.unique(np.stack([graph.source[inner], graph.target[inner]]), axis=1)
    cost = csr_array((lasts[source], (target, source)), shape=(k, k))
    made = np.full((k, len(graph.names)), np.inf)
    for c in range(len(graph.names)):
        goals = np.flatnonzero((graph.cluster == c) & graph.core)
        if not len(goals):
            continue
        whole = np.asarray(dijkstra(cost, indices=goals, min_only=True))
        for a, b in zip(source.tolist(), target.tolist(), strict=True):
            made[a, c] = min(made[a, c], whole[b])
    return made


def measure(graph: MotionGraph) -> Measures:
    """The measures of a graph."""
    lasts, own = graph.last - graph.first, ~graph.mirrored
    inner = graph.core[graph.source] & graph.core[graph.target]
    seconds = travel_s(graph)
    away = graph.core[:, None] & (graph.cluster[:, None] != np.arange(len(graph.names)))
    away &= np.isin(np.arange(len(graph.names)), graph.cluster[graph.core])
    reach = seconds[away & np.isfinite(seconds)]
    return Measures(
        len(graph.first), int(graph.core.sum()), int((inner & ~graph.natural).sum()),
        float(lasts[graph.core & own].sum() / (graph.take <= graph.take[graph.last[own] - 1].max()).sum()),
        float(inner.sum() / graph.core.sum()), len(np.unique(graph.cluster[graph.core & (graph.cluster >= 0)])),
        (float(np.median(reach)), float(np.quantile(reach, 0.95))) if len(reach) else (0.0, 0.0),
    )  # fmt: skip
