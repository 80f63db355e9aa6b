"""What a walk is for, as a person says it and as the search knows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from stream.chunk import Array, Samples
from stream.motion_graph import MotionGraph


@dataclass(frozen=True, slots=True)
class Aim:
    """What a walk is for: `times` nodes of a cluster (by number; -1: any), 0: to stay in it; or a polyline (p, 2) on the floor, followed
    in nodes of the cluster where these lead on."""

    cluster: int = -1
    times: int = 1
    path: Samples | None = None


@dataclass(frozen=True, slots=True)
class Sought:
    """
    path (p, 2), length (p,)  the way on the floor, and how far along it each point is; empty: none
    goal, gait (k,)           nodes of the cluster that is wanted (none: it is not what is sought); nodes in which the path is followed
    togo (k,)                 seconds from the start of each node to the cluster, or gait, that is wanted
    """

    path: Samples
    length: Samples
    goal: Array
    gait: Array
    togo: Samples


def sought(graph: MotionGraph, seconds: Samples, aim: Aim) -> Sought:
    """An aim as the search knows it; `seconds` as `seconds_to` says."""
    mine = graph.core & (graph.cluster == aim.cluster)
    none, every = np.zeros(len(mine), np.bool_), np.ones(len(mine), np.bool_)
    togo = np.ascontiguousarray(seconds[:, aim.cluster]) if aim.cluster >= 0 and mine.any() else np.zeros(len(mine))
    if aim.path is None:
        return Sought(np.zeros((0, 2)), np.zeros(0), mine if aim.cluster >= 0 else none, every, togo)
    path: Samples = np.asarray(aim.path, np.float64)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    return Sought(path, length, none, mine if aim.cluster >= 0 else every, togo)


def seconds_to(graph: MotionGraph) -> Samples:
    """(k, clusters) seconds from the start of each node to that of the first node of each cluster; inf: it is not reached."""
    k, inner = len(graph.first), graph.core[graph.source] & graph.core[graph.target]
    source, target = np.unique(np.stack([graph.source[inner], graph.target[inner]]), axis=1)
    back = csr_array(((graph.last - graph.first)[source] / graph.rate_hz, (target, source)), shape=(k, k))
    made = np.full((k, max(1, len(graph.names))), np.inf)
    for c in range(len(graph.names)):
        goals = np.flatnonzero((graph.cluster == c) & graph.core)
        if len(goals):
            made[:, c] = dijkstra(back, indices=goals, min_only=True)
    return made
