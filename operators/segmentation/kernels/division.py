"""Where two activities meet: the end of one is held until the start of the next is decided, and what lies between is divided."""

from __future__ import annotations

import math

from kinegraph.operators.segmentation.kernels.corrections import settle_count
from kinegraph.operators.segmentation.kernels.events import certainty, tell
from kinegraph.operators.segmentation.kernels.excursions import tell_excursions
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY,
    ACTIVITY_EVENT,
    BAND,
    BEGIN_EVENT,
    CLUSTER,
    CYCLES,
    EVENTS,
    HELD,
    HELD_AT,
    HELD_CERTAINTY,
    HELD_CLUSTER,
    HELD_CYCLES,
    HELD_FIRST,
    HELD_HOW,
    HELD_LAST,
    HELD_RADIUS,
    HELD_TO,
    LAG,
    MASS,
    NEXT,
    OUTINGS,
    PIECES_AT,
    PIECES_FROM,
    PRIMITIVE_EVENT,
    RADIUS,
    RESUMED,
    START,
    START_AT,
    TRANSITION,
    UNTOLD,
    UNTOLD_AT,
    Memory,
)
from kinegraph.operators.segmentation.kernels.separation import gaps
from kinegraph.stream.kernel import kernel


@kernel
def hold(s: Memory, last: int, to: int, how: int) -> None:
    """The open activity has ended with frame `last`, whose stamp is `to`; its repetitions are reported, its end not yet."""
    b = s.books
    b[HELD], b[HELD_FIRST], b[HELD_LAST] = 1, b[START], last
    b[HELD_AT], b[HELD_TO] = b[START_AT], to
    b[HELD_CYCLES], b[HELD_CLUSTER], b[HELD_HOW] = b[CYCLES] + b[OUTINGS], b[CLUSTER], how
    s.values[HELD_CERTAINTY], s.values[HELD_RADIUS] = certainty(s), s.values[RADIUS]
    b[ACTIVITY] += 1


@kernel
def let_go(s: Memory) -> None:
    """The held activity, if there is one, is reported with the end that it has."""
    b = s.books
    if not b[HELD]:
        return
    b[HELD] = 0
    if not b[HELD_CYCLES]:
        for cut in gaps(s, b[HELD_FIRST], b[HELD_LAST] + 1, s.values[HELD_RADIUS]):
            tell_held(s, cut - 1, s.times[(cut - 1) % s.times.shape[0]], 0)
            b[ACTIVITY] += 1
            b[PIECES_FROM], b[HELD_AT] = cut, s.times[cut % s.times.shape[0]]
            b[PIECES_AT] = b[HELD_AT]
            tell(s, BEGIN_EVENT, b[HELD_AT], b[ACTIVITY] - 1, 0, 0, 0, 0)
    tell_held(s, b[HELD_LAST], b[HELD_TO], b[HELD_HOW])


@kernel
def tell_held(s: Memory, last: int, to: int, how: int) -> None:
    """The held activity ends with frame `last`, stamp `to`, after a part that is no repetition, if there is one."""
    b = s.books
    count = b[HELD_CYCLES]
    if b[PIECES_FROM] <= last:
        count += tell_excursions(s, last, b[ACTIVITY] - 1, count, s.values[HELD_RADIUS])
    if b[PIECES_FROM] <= last:
        tell(s, PRIMITIVE_EVENT, b[PIECES_AT], to, b[ACTIVITY] - 1, 0, -1, how & 1)
    told = b[EVENTS]
    settle_count(s, b[ACTIVITY] - 1, count)
    tell(s, ACTIVITY_EVENT, b[HELD_AT], to, b[ACTIVITY] - 1, count, b[HELD_CLUSTER], how)
    s.ratings[told : b[EVENTS]] = s.values[HELD_CERTAINTY]


@kernel
def meets(s: Memory, first: int) -> bool:
    """Whether an activity that starts with frame `first` follows the held one without more than a transition, or a long rest, between."""
    b = s.books
    last = b[HELD_LAST]
    return bool(b[HELD] and first - last - 2 <= b[TRANSITION] and not last < b[RESUMED] <= first)


@kernel
def number_of(s: Memory, first: int) -> int:
    """The number of an activity, not told yet, that starts with frame `first`: what lies before it may be an activity of its own."""
    return int(s.books[ACTIVITY] + (first > s.books[UNTOLD] and not meets(s, first)))


@kernel
def divide(s: Memory) -> None:
    """The open activity's start is decided: if it follows the held one, they meet where that divides the frames between them best."""
    b = s.books
    if meets(s, b[START]):
        cut = border(s, b[START])
        if cut - 1 != b[HELD_LAST]:
            b[HELD_LAST], b[HELD_TO] = cut - 1, s.times[(cut - 1) % s.times.shape[0]]
            b[UNTOLD], b[UNTOLD_AT] = cut, s.times[cut % s.times.shape[0]]
        b[START] = cut
    let_go(s)


@kernel
def border(s: Memory, first: int) -> int:
    """The first frame that lies nearer to the activity from `first` on than to the held one, on the whole: a sum of differences says it.

    Repetitions of the held one that are reported stay in it, and all but its last frames, half as many again as open an activity.
    """
    b = s.books
    start = max(b[PIECES_FROM], b[HELD_FIRST] + b[MASS], b[HELD_LAST] + 1 - b[MASS] - b[MASS] // 2)
    start = min(start, first)
    best, total, cut = 0.0, 0.0, start
    for i in range(start, first):
        before, after = math.inf, math.inf
        for k in range(b[BAND], b[LAG] + 1):
            if b[HELD_FIRST] <= i - k < start:
                before = min(before, s.rows[i % s.rows.shape[0], k])
            if first <= i + k < b[NEXT]:
                after = min(after, s.rows[(i + k) % s.rows.shape[0], k])
        if before < math.inf and after < math.inf:
            total += before - after
        if total < best:
            best, cut = total, i + 1
    return int(cut)
