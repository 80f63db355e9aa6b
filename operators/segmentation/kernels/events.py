"""Events as rows of a table: what kernels tell, and when the frames were that they speak of."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.layout import (
    RADIUS_EVENT,
    Memory,
)
from kinegraph.stream.kernel import kernel

CHANCE = 0.7
"""Repetitions that lie on average this many radii from their exemplar may be chance: in recordings of random phases few lie nearer."""


@kernel
def tell(s: Memory, kind: int, a: int, c: int, d: int, e: int, f: int, g: int) -> None:
    """Write an event: its kind, the stamp of the frame that decided it, six numbers; and how certain repetitions are, or the radius."""
    at, events = s.event_count, s.events
    events[at, 0], events[at, 1] = kind, s.now
    events[at, 2], events[at, 3], events[at, 4], events[at, 5], events[at, 6], events[at, 7] = a, c, d, e, f, g
    s.ratings[at] = s.radius if kind == RADIUS_EVENT else certainty(s)
    s.event_count = at + 1


@kernel
def certainty(s: Memory) -> float:
    """How certain the open activity's repetitions are, by how near they come to the exemplar, which as a rule is one of them: 1, the
    same; 0, chance comes as near, or no activity is open."""
    later = s.cycles - 1
    if not (s.is_open and s.is_begun) or later < 1 or s.radius <= 0.0:
        return 0.0
    return float(max(0.0, 1.0 - s.prices / (later * CHANCE * s.radius)))


@kernel
def stamp(s: Memory, i: int) -> int:
    """When a frame was; the first one after the last activity, and the activity's first, may have left the window."""
    if i == s.unreported:
        return int(s.unreported_at)
    if i == s.start and s.is_start_final:
        return int(s.start_at)
    return int(s.times[i % s.times.shape[0]])
