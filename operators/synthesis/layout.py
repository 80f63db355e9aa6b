"""What the search on a motion graph works on: the graph, what is sought, the walks that it follows, and the search itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.domain.motion_graph import MotionGraph, edges_from

WALK = np.dtype([
    ("node", "<i8"), ("frame", "<i8"), ("turn", "<f8"), ("x", "<f8"), ("z", "<f8"), ("seconds", "<f8"), ("hits", "<f8"), ("first", "<i8"),
    ("score", "<f8"),
])  # fmt: skip
"""A walk: where it is, how it is placed, how long it takes, how many looks are in forbidden areas, its first edge, its score."""
SEARCH = np.dtype([
    ("deep", "<i8"), ("count", "<i8"), ("best", "<f8"), ("found", "<i8"), ("chosen", "<i8"), ("next", "<i8"), ("kept", "<i8"),
    ("origin", "<i8"),
])  # fmt: skip
"""A search: how deep it is, how many walks it follows, the best score at the cluster that is wanted, the first edge of that walk, that of
the best walk of all; which walk goes on next, how many one node further are kept, and the first node's first edge."""


class _GraphNumbers:
    blend: int
    rate_hz: float


@record
@dataclass
class Ways(_GraphNumbers):
    """A motion graph for kernels; `begin` (k + 1,): where the edges of each node begin."""

    numbers: Array
    poses: Samples
    first: Times
    last: Times
    core: Array
    begin: Times
    target: Times
    leave: Times
    enter: Times
    natural: Array
    turn: Samples
    shift: Samples

    @classmethod
    def of(cls, g: MotionGraph) -> Ways:
        """Arrays of one type and layout: a record's are not converted."""
        made = cls(
            np.zeros((), NUMBERS), _reals(g.poses), _ints(g.first), _ints(g.last), _bools(g.core), _ints(edges_from(g)),
            _ints(g.target), _ints(g.leave), _ints(g.enter), _bools(g.natural), _reals(g.turn), _reals(g.shift),
        )  # fmt: skip
        made.blend, made.rate_hz = g.blend, g.rate_hz
        return made


NUMBERS = numbers_of(_GraphNumbers)


def _ints(a: Array) -> Times:
    return np.array(a, np.int64, order="C")


def _reals(a: Array) -> Samples:
    return np.array(a, np.float64, order="C")


def _bools(a: Array) -> Array:
    return np.array(a, np.bool_, order="C")


@record
@dataclass(frozen=True)
class Sought:
    """
    goal (k,)   nodes of the cluster that is wanted (all false: no cluster is)
    togo (k,)   seconds from the start of each node to that cluster; 0: no goal, or already there
    """

    goal: Array
    togo: Samples
