"""Inside an activity: its first cycle is found, its repetitions are followed, told, and compared."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.anchor import first_whole, in_phase, lead_in, look_back
from kinegraph.operators.segmentation.kernels.bouts import close_bout, part
from kinegraph.operators.segmentation.kernels.clusters import keep, recognise, use
from kinegraph.operators.segmentation.kernels.corrections import forget_returns, tell_span
from kinegraph.operators.segmentation.kernels.cycles import (
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
    Memory,
)
from kinegraph.operators.segmentation.kernels.provisional import conclude, is_last_return, replaces
from kinegraph.operators.segmentation.kernels.rest import reported_at_rest
from kinegraph.stream.kernel import kernel


@kernel
def search_from(s: Memory, origin: int) -> None:
    s.is_tracking, s.origin = False, origin
    s.sums[(origin - 1) % s.sums.shape[0]] = 0.0


@kernel
def explore(s: Memory, i: int) -> None:
    """Frame `i` of an activity: look for its first cycle, or follow that cycle's later ones."""
    if s.is_tracking:
        pursue(s, i)
        return
    sum_up(s, i)
    length = cycle_length(s, i, False)
    if length:
        take_up(s, i, length)


@kernel
def take_up(s: Memory, i: int, length: int) -> None:
    """A cycle of `length` frames is found at frame `i`: follow a known exemplar that fits, or keep this one."""
    origin = max(s.origin, i + 1 - 2 * length)
    slot, met = recognise(s, origin, i, length)
    known = slot >= 0
    if not known:
        first = lead_in(s, origin if s.is_start_final else s.start, length)
        if not s.is_start_final:
            s.start = first
            origin = max(first, i + 1 - 2 * length)
        slot = keep(s, in_phase(s, first, origin, i + 1 - length), length)
    use(s, slot)
    if s.is_start_final and s.cycles and s.cluster_numbers[slot] != s.cluster:
        change(s, origin)
    s.is_tracking, s.slot, s.length = True, slot, s.exemplar_sizes[slot]
    forget_returns(s)
    s.like_count, s.farthest = 0, 0.0
    if not s.is_start_final:
        s.start = look_back(s, i, s.start)
        origin = s.start
        tell_start(s)
    else:
        origin = look_back(s, i, origin)
    s.origin = origin
    begin_tracking(s, first_whole(origin, met, s.length) if known else origin)
    for j in range(origin, i + 1):
        if s.is_tracking:
            pursue(s, j)
        else:
            sum_up(s, j)


@kernel
def change(s: Memory, origin: int) -> None:
    """Another cycle than before: the activity ends with its last repetition, or if that was long ago before the cycle; another begins."""
    close_bout(s)
    if origin - s.pieces_from > s.firm:
        piece(s, origin - 1, False)
    conclude(s, s.cycles + s.outings)
    hold(s, s.pieces_from - 1, s.reported_to, how(s))
    s.seed = s.unreported = s.pieces_from
    s.unreported_at = s.pieces_at
    s.start, s.is_start_final = max(origin, s.seed), False
    s.is_pending = s.is_paused = False
    s.count = s.cycles = s.outings = s.bout = 0
    s.kinds[:], s.prices = 0, 0.0
    s.cluster = -1


@kernel
def pursue(s: Memory, i: int) -> None:
    fresh = s.best_end
    if track(s, i):
        accept(s)
    elif fresh < 0 and s.best_end >= 0:
        s.back -= is_last_return(s)
        number = s.count + s.back + (not replaces(s))
        tell_span(s, stamp(s, s.best_start), stamp(s, s.best_end), s.activity, number)
    length = s.length
    since = s.pending_to if s.is_pending else s.origin
    if i - since <= slack(length) + LONGEST * length + patience(length):
        return
    if s.is_pending:  # whatever path is under way, it started more than a cycle after the pending repetition's end
        settle(s, s.pending_to)
    close_bout(s)
    if s.best_end < 0:
        search_from(s, max(s.pieces_from, i - s.max_lag))
        for j in range(s.origin, i + 1):
            sum_up(s, j)


@kernel
def accept(s: Memory) -> None:
    """The best path is a repetition: the one before it ends where it starts, or at the rest between. Of two that start within half a cycle
    the cheaper one is."""
    start, end = s.best_start, s.best_end
    close = replaces(s)
    if close and s.best >= s.price:
        s.last = max(s.last, end)
        release(s)
        return
    if close:
        s.count -= 1
    elif s.is_pending:
        s.is_paused |= left_out(s, s.pending_from, end) > s.transition
        settle(
            s,
            before_rest(s, start - 1) if start - 1 - s.pending_to <= slack(s.length) else min(s.pending_to, start - 1),
        )
        part(s, start)
    s.last = max(s.last, end)
    start = max(start, s.pieces_from)
    start = after_rest(s, start)
    if start > s.pieces_from:
        piece(s, start - 1, False)
    s.is_pending, s.pending_from, s.pending_to = True, start, end
    s.price = s.best
    s.cluster = s.cluster_numbers[s.slot]
    s.count += 1
    forget_returns(s)
    tell_span(s, stamp(s, start), stamp(s, end), s.activity, s.count)
    release(s)


@kernel
def left_out(s: Memory, first: int, last: int) -> int:
    """How many frames were left out between frames `first` and `last`, of rests as a rule."""
    apart = s.times[last % s.times.shape[0]] - s.times[first % s.times.shape[0]]
    return int(apart / s.period_ns + 0.5) - (last - first)


@kernel
def before_rest(s: Memory, last: int) -> int:
    """The last frame of the pending repetition, which may go on from its path's end to frame `last`, but not into a rest."""
    for i in range(s.pending_to + 1, last + 1):
        if reported_at_rest(s, i):
            return int(i - 1)
    return last


@kernel
def after_rest(s: Memory, start: int) -> int:
    """The first frame of a repetition whose path starts at frame `start`, soon after a rest: the one behind that. What follows the last
    repetition and is at rest is no part of the activity."""
    first = start
    for i in range(start - 1, max(s.pieces_from, start - 1 - slack(s.length)) - 1, -1):
        if reported_at_rest(s, i):
            first = i + 1
            break
    while s.pieces_from < first and reported_at_rest(s, s.pieces_from):
        s.pieces_from += 1
        s.pieces_at = s.times[s.pieces_from % s.times.shape[0]]
    return int(first)
