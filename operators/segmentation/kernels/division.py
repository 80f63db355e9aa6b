"""Where two activities meet: the end of one is held until the start of the next is decided, and what lies between is divided."""

from __future__ import annotations

import math

from kinegraph.operators.segmentation.kernels.corrections import settle_count
from kinegraph.operators.segmentation.kernels.events import certainty, tell
from kinegraph.operators.segmentation.kernels.excursions import tell_excursions
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY_EVENT,
    PRIMITIVE_EVENT,
    Memory,
)
from kinegraph.stream.kernel import kernel


@kernel
def hold(s: Memory, last: int, to: int, how: int) -> None:
    """The open activity has ended with frame `last`, whose stamp is `to`; its repetitions are reported, its end not yet."""
    s.is_held, s.held_first, s.held_last = True, s.start, last
    s.held_at, s.held_to = s.start_at, to
    s.held_cycles, s.held_cluster, s.held_how = s.cycles + s.outings, s.cluster, how
    s.held_certainty, s.held_radius = certainty(s), s.radius
    s.activity += 1


@kernel
def let_go(s: Memory) -> None:
    """The held activity, if there is one, is reported with the end that it has."""
    if not s.is_held:
        return
    s.is_held = False
    last, to, how, count = s.held_last, s.held_to, s.held_how, s.held_cycles
    if s.pieces_from <= last:
        count += tell_excursions(s, last, s.activity - 1, count, s.held_radius)
    if s.pieces_from <= last:
        tell(s, PRIMITIVE_EVENT, s.pieces_at, to, s.activity - 1, 0, -1, how & 1)
    told = s.event_count
    settle_count(s, s.activity - 1, count)
    tell(s, ACTIVITY_EVENT, s.held_at, to, s.activity - 1, count, s.held_cluster, how)
    s.ratings[told : s.event_count] = s.held_certainty


@kernel
def meets(s: Memory, first: int) -> bool:
    """Whether an activity that starts with frame `first` follows the held one without more than a transition, or a long rest, between."""
    last = s.held_last
    return bool(s.is_held and first - last - 2 <= s.transition and not last < s.resumed <= first)


@kernel
def number_of(s: Memory, first: int) -> int:
    """The number of an activity, not told yet, that starts with frame `first`: what lies before it may be an activity of its own."""
    return int(s.activity + (first > s.unreported and not meets(s, first)))


@kernel
def divide(s: Memory) -> None:
    """The open activity's start is decided: if it follows the held one, they meet where that divides the frames between them best."""
    if meets(s, s.start):
        cut = border(s, s.start)
        if cut - 1 != s.held_last:
            s.held_last, s.held_to = cut - 1, s.times[(cut - 1) % s.times.shape[0]]
            s.unreported, s.unreported_at = cut, s.times[cut % s.times.shape[0]]
        s.start = cut
    let_go(s)


@kernel
def border(s: Memory, first: int) -> int:
    """The first frame that lies nearer to the activity from `first` on than to the held one, on the whole: a sum of differences says it.

    Repetitions of the held one that are reported stay in it, and all but its last frames, half as many again as open an activity.
    """
    start = max(s.pieces_from, s.held_first + s.mass, s.held_last + 1 - s.mass - s.mass // 2)
    start = min(start, first)
    best, total, cut = 0.0, 0.0, start
    for i in range(start, first):
        before, after = math.inf, math.inf
        for k in range(s.band, s.max_lag + 1):
            if s.held_first <= i - k < start:
                before = min(before, s.rows[i % s.rows.shape[0], k])
            if first <= i + k < s.next_frame:
                after = min(after, s.rows[(i + k) % s.rows.shape[0], k])
        if before < math.inf and after < math.inf:
            total += before - after
        if total < best:
            best, cut = total, i + 1
    return int(cut)
