"""Inside an activity: its first cycle is found, its repetitions are followed, told, and compared."""

from __future__ import annotations

import numpy as np

from operators.segmentation.clusters import NUMBER, SIZE, alike, keep, recognise, use
from operators.segmentation.cycles import GAIN, LONGEST, begin_tracking, cycle_length, patience, release, sum_up, track
from operators.segmentation.events import stamp, tell
from operators.segmentation.layout import (
    ACTIVITY,
    ACTIVITY_EVENT,
    BEGIN_EVENT,
    BELIEVED_EVENT,
    BEST,
    BEST_END,
    BEST_START,
    CLUSTER,
    COUNT,
    COUNT_EVENT,
    CYCLES,
    FROM,
    LAG,
    LAST,
    LENGTH,
    MERGE_EVENT,
    MODE,
    NEXT,
    ORIGIN,
    PENDING,
    PIECES_AT,
    PIECES_FROM,
    PRICE,
    PRIMITIVE_EVENT,
    RADIUS,
    REPEATED,
    SEARCH,
    SEED,
    SLOT,
    START,
    START_AT,
    TO,
    TOLD,
    TOLD_TO,
    TRACK,
    UNTOLD,
    UNTOLD_AT,
    WINDOW,
    Memory,
)
from stream.kernel import kernel


@kernel
def search_from(s: Memory, origin: int) -> None:
    b = s.books
    b[MODE], b[ORIGIN] = SEARCH, origin
    s.sums[(origin - 1) % s.sums.shape[0]] = 0.0


@kernel
def explore(s: Memory, i: int) -> None:
    """Frame `i` of an activity: look for its first cycle, or follow that cycle's later ones."""
    b = s.books
    if b[MODE] == TRACK:
        pursue(s, i)
        return
    sum_up(s, i)
    length = cycle_length(s, i, False)
    if length:
        take_up(s, i, length)


@kernel
def take_up(s: Memory, i: int, length: int) -> None:
    """A cycle of `length` frames is found at frame `i`: follow a known exemplar that fits, or keep this one."""
    b = s.books
    origin = max(b[ORIGIN], i + 1 - 2 * length)
    slot = recognise(s, origin, i, length)
    if slot < 0:
        slot = keep(s, origin, length)
    use(s, slot)
    if b[TOLD] and b[CYCLES] and s.clusters[slot, NUMBER] != b[CLUSTER]:
        change(s, origin)
    b[MODE], b[SLOT], b[LENGTH] = TRACK, slot, s.clusters[slot, SIZE]
    if not b[TOLD]:
        b[START] = look_back(s, i, b[START])
        origin = b[START]
        tell_start(s)
    else:
        origin = look_back(s, i, origin)
    b[ORIGIN] = origin
    begin_tracking(s, origin)
    for j in range(origin, i + 1):
        if b[MODE] == TRACK:
            pursue(s, j)
        else:
            sum_up(s, j)


@kernel
def look_back(s: Memory, i: int, start: int) -> int:
    """Where the repetitions up to frame `i` begin, once their cycle is known: those just before `start` belong to them."""
    b = s.books
    first = max(b[PIECES_FROM] if b[TOLD] else b[UNTOLD], start - b[LAG])
    if first >= start:
        return start
    starts, ends, count = np.empty(2 * b[LAG], np.int64), np.empty(2 * b[LAG], np.int64), 0
    begin_tracking(s, first)
    for j in range(first, i + 1):
        if track(s, j):
            starts[count], ends[count] = b[BEST_START], b[BEST_END]
            count += 1
            release(s)
    for k in range(count - 1, -1, -1):
        if starts[k] < start and ends[k] + slack(b[LENGTH]) >= start:
            start = starts[k]
    return start


@kernel
def change(s: Memory, origin: int) -> None:
    """Another cycle than before: the activity ends with its last repetition, and another begins."""
    b = s.books
    tell(s, ACTIVITY_EVENT, b[START_AT], b[TOLD_TO], b[ACTIVITY], b[CYCLES], b[CLUSTER], 0)
    b[ACTIVITY] += 1
    b[SEED] = b[UNTOLD] = b[PIECES_FROM]
    b[UNTOLD_AT] = b[PIECES_AT]
    b[START], b[TOLD] = max(origin, b[SEED]), 0
    b[COUNT] = b[PENDING] = b[CYCLES] = 0
    b[CLUSTER] = -1


@kernel
def pursue(s: Memory, i: int) -> None:
    b = s.books
    fresh = b[BEST_END]
    if track(s, i):
        accept(s)
    elif fresh < 0 and b[BEST_END] >= 0:
        tell(s, COUNT_EVENT, b[ACTIVITY], b[COUNT] + 1, 0, 0, 0, 0)
        tell(
            s,
            BELIEVED_EVENT,
            stamp(s, b[BEST_START]),
            stamp(s, b[BEST_END]),
            b[ACTIVITY],
            b[COUNT] + 1,
            0,
            0,
        )
    length = b[LENGTH]
    since = b[TO] if b[PENDING] else b[ORIGIN]
    if b[BEST_END] < 0 and i - since > slack(length) + LONGEST * length + patience(length):
        if b[PENDING]:
            settle(s, b[TO])
        search_from(s, max(b[PIECES_FROM], i - b[LAG]))
        for j in range(b[ORIGIN], i + 1):
            sum_up(s, j)


@kernel
def slack(length: int) -> int:
    """The longest pause between two repetitions that counts as part of the first."""
    return length // 2


@kernel
def accept(s: Memory) -> None:
    """The best path is a repetition: the one before it ends where it starts. Of two that start within half a cycle the cheaper one is."""
    b = s.books
    start, end = b[BEST_START], b[BEST_END]
    close = b[PENDING] and start - b[FROM] < slack(b[LENGTH])
    if close and s.values[BEST] >= s.values[PRICE]:
        b[LAST] = max(b[LAST], end)
        release(s)
        return
    if close:
        b[COUNT] -= 1
    elif b[PENDING]:
        settle(s, start - 1 if start - 1 - b[TO] <= slack(b[LENGTH]) else min(b[TO], start - 1))
    b[LAST] = max(b[LAST], end)
    start = max(start, b[PIECES_FROM])
    if start > b[PIECES_FROM]:
        piece(s, start - 1, False)
    b[PENDING], b[FROM], b[TO] = 1, start, end
    s.values[PRICE] = s.values[BEST]
    b[CLUSTER] = s.clusters[b[SLOT], NUMBER]
    b[COUNT] += 1
    release(s)


@kernel
def settle(s: Memory, last: int) -> None:
    """The pending repetition ends at `last`: it is told, and compared with another cluster's exemplar."""
    b = s.books
    b[CYCLES] += 1
    if b[CYCLES] > 1:
        b[REPEATED] = b[NEXT] + b[WINDOW]
    b[PENDING] = 0
    tell(s, PRIMITIVE_EVENT, stamp(s, b[FROM]), stamp(s, last), b[ACTIVITY], b[CYCLES], b[CLUSTER], 0)
    told_to(s, last)
    slot = b[SLOT]
    other = alike(s, slot, b[FROM], last)
    if other >= 0:
        gone, stays = (slot, other) if s.clusters[slot, NUMBER] > s.clusters[other, NUMBER] else (other, slot)
        tell(s, MERGE_EVENT, s.clusters[gone, NUMBER], s.clusters[stays, NUMBER], 0, 0, 0, 0)
        if gone == slot:
            s.clusters[slot, NUMBER], s.clusters[other, NUMBER] = s.clusters[other, NUMBER], -1
            b[CLUSTER] = s.clusters[slot, NUMBER]
        else:
            s.clusters[other, NUMBER] = -1


@kernel
def told_to(s: Memory, last: int) -> None:
    """Primitives are told up to frame `last`."""
    b = s.books
    b[TOLD_TO] = stamp(s, last)
    b[PIECES_FROM], b[PIECES_AT] = last + 1, s.times[(last + 1) % s.times.shape[0]]


@kernel
def piece(s: Memory, last: int, forced: bool) -> None:
    """A part of an activity that is no repetition."""
    b = s.books
    tell(s, PRIMITIVE_EVENT, b[PIECES_AT], stamp(s, last), b[ACTIVITY], 0, -1, forced)
    told_to(s, last)


@kernel
def under_way(s: Memory, t: int) -> bool:
    """Whether frame `t` still runs along the cycle: a path beyond its first third lies within the radius on the way."""
    b = s.books
    if b[MODE] != TRACK or not b[COUNT]:
        return False
    radius = s.values[RADIUS]
    for c in range(b[LENGTH] // 3, b[LENGTH]):
        start = s.begin[0, c]
        if (
            start >= 0
            and start <= b[LAST] + slack(b[LENGTH])
            and s.cost[0, c] <= (HOLDS - GAIN) * radius * (t - start + c + 2)
        ):
            return True
    return False


HOLDS = 0.8
"""A path under way keeps an activity open while its mean distance is at most this share of the radius."""


@kernel
def tell_start(s: Memory) -> None:
    """The activity's start is decided; what lies before it is a stretch of its own."""
    b = s.books
    first = b[START]
    b[START_AT] = b[UNTOLD_AT] if first == b[UNTOLD] else s.times[first % s.times.shape[0]]
    b[TOLD] = 1
    if first > b[UNTOLD]:
        stretch(s, first - 1, False)
    b[PIECES_FROM], b[PIECES_AT] = first, b[START_AT]
    tell(s, BEGIN_EVENT, b[START_AT], b[ACTIVITY], 0, 0, 0, 0)


STRETCH = 2
"""Added to `forced` in an activity's event that is a stretch between activities."""


@kernel
def stretch(s: Memory, last: int, forced: bool) -> None:
    """What lies between activities, from UNTOLD to `last`, repeats nothing: one primitive."""
    b = s.books
    onset, stop = b[UNTOLD_AT], s.times[last % s.times.shape[0]]
    tell(s, PRIMITIVE_EVENT, onset, stop, b[ACTIVITY], 0, -1, forced)
    tell(s, ACTIVITY_EVENT, onset, stop, b[ACTIVITY], 0, -1, STRETCH + forced)
    b[ACTIVITY] += 1
