"""Inside an activity: its first cycle is found, its repetitions are followed, told, and compared."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.anchor import first_whole, in_phase, lead_in, look_back
from kinegraph.operators.segmentation.kernels.bouts import close_bout, part
from kinegraph.operators.segmentation.kernels.clusters import keep, recognise, use
from kinegraph.operators.segmentation.kernels.corrections import forget_returns, tell_span
from kinegraph.operators.segmentation.kernels.cycles import (
    GAIN,
    LONGEST,
    begin_tracking,
    cycle_length,
    patience,
    release,
    slack,
    sum_up,
    track,
)
from kinegraph.operators.segmentation.kernels.division import hold
from kinegraph.operators.segmentation.kernels.events import stamp
from kinegraph.operators.segmentation.kernels.final import how, piece, settle, tell_start
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY,
    BACK,
    BEST,
    BEST_END,
    BEST_START,
    BOUT,
    CLUSTER,
    COUNT,
    CYCLES,
    FARTHEST,
    FIRM,
    FROM,
    LAG,
    LAST,
    LENGTH,
    LIKE,
    MODE,
    NUMBER,
    ORIGIN,
    OUTINGS,
    PENDING,
    PIECES_AT,
    PIECES_FROM,
    PRICE,
    PRICES,
    RADIUS,
    SEARCH,
    SEED,
    SIZE,
    SLOT,
    START,
    TO,
    TOLD,
    TOLD_TO,
    TRACK,
    UNTOLD,
    UNTOLD_AT,
    Memory,
)
from kinegraph.operators.segmentation.kernels.provisional import conclude, expect, is_last_return, replaces
from kinegraph.operators.segmentation.kernels.rest import reported_at_rest
from kinegraph.stream.kernel import kernel


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
    elif b[TOLD] and b[COUNT]:
        expect(s, i)


@kernel
def take_up(s: Memory, i: int, length: int) -> None:
    """A cycle of `length` frames is found at frame `i`: follow a known exemplar that fits, or keep this one."""
    b = s.books
    origin = max(b[ORIGIN], i + 1 - 2 * length)
    slot, met = recognise(s, origin, i, length)
    known = slot >= 0
    if not known:
        first = lead_in(s, origin if b[TOLD] else b[START], length)
        if not b[TOLD]:
            b[START] = first
            origin = max(first, i + 1 - 2 * length)
        slot = keep(s, in_phase(s, first, origin, i + 1 - length), length)
    use(s, slot)
    if b[TOLD] and b[CYCLES] and s.clusters[slot, NUMBER] != b[CLUSTER]:
        change(s, origin)
    b[MODE], b[SLOT], b[LENGTH] = TRACK, slot, s.clusters[slot, SIZE]
    forget_returns(s)
    b[LIKE], s.values[FARTHEST] = 0, 0.0
    if not b[TOLD]:
        b[START] = look_back(s, i, b[START])
        origin = b[START]
        tell_start(s)
    else:
        origin = look_back(s, i, origin)
    b[ORIGIN] = origin
    begin_tracking(s, first_whole(origin, met, b[LENGTH]) if known else origin)
    for j in range(origin, i + 1):
        if b[MODE] == TRACK:
            pursue(s, j)
        else:
            sum_up(s, j)


@kernel
def change(s: Memory, origin: int) -> None:
    """Another cycle than before: the activity ends with its last repetition, or if that was long ago before the cycle; another begins."""
    b = s.books
    close_bout(s)
    if origin - b[PIECES_FROM] > b[FIRM]:
        piece(s, origin - 1, False)
    conclude(s, b[CYCLES] + b[OUTINGS])
    hold(s, b[PIECES_FROM] - 1, b[TOLD_TO], how(s))
    b[SEED] = b[UNTOLD] = b[PIECES_FROM]
    b[UNTOLD_AT] = b[PIECES_AT]
    b[START], b[TOLD] = max(origin, b[SEED]), 0
    b[COUNT] = b[PENDING] = b[CYCLES] = b[OUTINGS] = b[BOUT] = 0
    s.kinds[:], s.values[PRICES] = 0, 0.0
    b[CLUSTER] = -1


@kernel
def pursue(s: Memory, i: int) -> None:
    b = s.books
    fresh = b[BEST_END]
    if track(s, i):
        accept(s)
    elif fresh < 0 and b[BEST_END] >= 0:
        b[BACK] -= is_last_return(s)
        number = b[COUNT] + b[BACK] + (not replaces(s))
        tell_span(s, stamp(s, b[BEST_START]), stamp(s, b[BEST_END]), b[ACTIVITY], number)
    length = b[LENGTH]
    since = b[TO] if b[PENDING] else b[ORIGIN]
    if i - since <= slack(length) + LONGEST * length + patience(length):
        return
    if b[PENDING]:  # whatever path is under way, it started more than a cycle after the pending repetition's end
        settle(s, b[TO])
    close_bout(s)
    if b[BEST_END] < 0:
        search_from(s, max(b[PIECES_FROM], i - b[LAG]))
        for j in range(b[ORIGIN], i + 1):
            sum_up(s, j)


@kernel
def accept(s: Memory) -> None:
    """The best path is a repetition: the one before it ends where it starts, or at the rest between. Of two that start within half a cycle
    the cheaper one is."""
    b = s.books
    start, end = b[BEST_START], b[BEST_END]
    close = replaces(s)
    if close and s.values[BEST] >= s.values[PRICE]:
        b[LAST] = max(b[LAST], end)
        release(s)
        return
    if close:
        b[COUNT] -= 1
    elif b[PENDING]:
        settle(s, before_rest(s, start - 1) if start - 1 - b[TO] <= slack(b[LENGTH]) else min(b[TO], start - 1))
        part(s, start)
    b[LAST] = max(b[LAST], end)
    start = max(start, b[PIECES_FROM])
    start = after_rest(s, start)
    if start > b[PIECES_FROM]:
        piece(s, start - 1, False)
    b[PENDING], b[FROM], b[TO] = 1, start, end
    s.values[PRICE] = s.values[BEST]
    b[CLUSTER] = s.clusters[b[SLOT], NUMBER]
    b[COUNT] += 1
    forget_returns(s)
    tell_span(s, stamp(s, start), stamp(s, end), b[ACTIVITY], b[COUNT])
    release(s)


@kernel
def before_rest(s: Memory, last: int) -> int:
    """The last frame of the pending repetition, which may go on from its path's end to frame `last`, but not into a rest."""
    for i in range(s.books[TO] + 1, last + 1):
        if reported_at_rest(s, i):
            return int(i - 1)
    return last


@kernel
def after_rest(s: Memory, start: int) -> int:
    """The first frame of a repetition whose path starts at frame `start`, soon after a rest: the one behind that. What follows the last
    repetition and is at rest is no part of the activity."""
    b, first = s.books, start
    for i in range(start - 1, max(b[PIECES_FROM], start - 1 - slack(b[LENGTH])) - 1, -1):
        if reported_at_rest(s, i):
            first = i + 1
            break
    while b[PIECES_FROM] < first and reported_at_rest(s, b[PIECES_FROM]):
        b[PIECES_FROM] += 1
        b[PIECES_AT] = s.times[b[PIECES_FROM] % s.times.shape[0]]
    return int(first)


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
