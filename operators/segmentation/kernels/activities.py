"""Frame by frame: an activity opens, begins, and closes; every decision is reported as an event."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.bouts import close_bout
from kinegraph.operators.segmentation.kernels.corrections import forget_returns
from kinegraph.operators.segmentation.kernels.cycles import cycle_length
from kinegraph.operators.segmentation.kernels.distances import (
    choose_band,
    choose_radius,
    insert,
    mark,
    reflect,
    typical,
)
from kinegraph.operators.segmentation.kernels.division import hold, let_go, number_of
from kinegraph.operators.segmentation.kernels.events import stamp, tell
from kinegraph.operators.segmentation.kernels.final import how, settle, stretch, tell_start
from kinegraph.operators.segmentation.kernels.gestures import believe_behind, watch_returns
from kinegraph.operators.segmentation.kernels.layout import (
    BAND,
    BEGUN,
    BELIEVED,
    BELIEVED_EVENT,
    BEST_END,
    BEST_START,
    BOUT,
    CLUSTER,
    COUNT,
    CYCLES,
    DONE,
    EARLY_RADIUS,
    EVENTS,
    EVERY,
    FIRM,
    FIXED,
    GROWN,
    HELD,
    HELD_LAST,
    LAG,
    LAST,
    LEARN,
    MASS,
    MODE,
    NEXT,
    NOTICED,
    NOW,
    OPEN,
    OPENED,
    OUTINGS,
    PENDING,
    PRICES,
    QUIET,
    RADIUS,
    RADIUS_AT,
    RADIUS_EVENT,
    RECENT,
    REPEATED,
    REST,
    RESTED,
    RETURNED,
    ROWS,
    SEARCH,
    SEED,
    SETTLE,
    SINCE,
    START,
    STOOD,
    TO,
    TOLD,
    TRACK,
    TRANSITION,
    UNSEEN,
    UNTOLD,
    UNTOLD_AT,
    Memory,
)
from kinegraph.operators.segmentation.kernels.provisional import conclude, foresee, give_up, keep_count, look_ahead
from kinegraph.operators.segmentation.kernels.repetitions import accept, explore, search_from, take_up, under_way
from kinegraph.operators.segmentation.kernels.rest import at_rest, choose_peak, rests, tell_rest, unseen
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

ROOM = 1024
"""One frame never leads to more events."""


@kernel
def follow(s: Memory, x: Samples, mirrored: Samples, time: Times, first: int, gap: bool) -> int:
    """Work through frames `x` (n, features) with stamps `time` (n,) from row `first` on, while there is room for events.

    mirrored  (n, features)  their mirror images; NaN: not known. (0, features): there are none

    `gap`: what is open ends before row `first`. Returns the row to go on with; EVENTS rows were written.
    """
    s.books[EVENTS] = 0
    i = first
    while i < x.shape[0] and s.books[EVENTS] + 2 * ROOM <= s.events.shape[0]:
        s.books[NOW] = time[i]
        if gap and i == first:
            end(s)
        if rests(s, x[i], time[i]):
            leave_out(s, s.books[RESTED])
        elif unseen(s, x[i]):
            leave_out(s, s.books[UNSEEN] - s.books[REST])
        else:
            t = insert(s, x[i], time[i])
            if mirrored.shape[0]:
                reflect(s, t, mirrored[i])
            step(s, t)
        i += 1
    return i


@kernel
def leave_out(s: Memory, count: int) -> None:
    """The newest `count` frames were not worked through: after a transition no activity can meet the one before, after LAG all ends."""
    if count == s.books[TRANSITION] + 1 and not s.books[OPEN]:
        let_go(s)
    if count == s.books[LAG]:
        stand(s)


@kernel
def step(s: Memory, t: int) -> None:
    b = s.books
    choose_peak(s, t)
    if t == b[UNTOLD]:
        b[UNTOLD_AT] = s.times[t % s.times.shape[0]]
    if not b[OPEN]:
        if t - b[SINCE] + 1 < b[LEARN]:
            anticipate(s, t)
            return
        if b[BELIEVED] and t - b[SINCE] + 1 >= b[LEARN] + b[MASS]:
            give_up(s)
        if b[HELD] and t - b[HELD_LAST] > b[LAG] + b[TRANSITION]:
            let_go(s)
        if t >= b[RADIUS_AT]:
            choose_radius(s, t)
            b[RADIUS_AT] = t + b[EVERY]
        elif t - b[LAG] >= b[SEED]:
            b[ROWS] -= s.near[(t - b[LAG]) % s.near.shape[0]] == 1
        near = mark(s, t, b[SEED])
        b[ROWS] += near
        if near and b[ROWS] >= b[MASS]:
            open_up(s, t)
    elif mark(s, t, b[SEED]):
        b[LAST] = t
    if b[OPEN]:
        quiet = t - b[LAST] >= b[QUIET]
        if quiet or t >= b[OPENED] + b[SETTLE]:
            sought = b[BEGUN] and (b[TOLD] or b[RETURNED] or (t - b[OPENED]) % b[SETTLE])
            if not sought:
                begin(s)
        if b[BEGUN]:
            while b[DONE] < t:
                b[DONE] += 1
                explore(s, b[DONE])
            if not b[TOLD] and t >= b[OPENED] + b[FIRM]:
                if counts(s):
                    tell_start(s)
                elif t >= b[START] + 2 * b[LAG]:
                    b[OPEN] = b[BEGUN] = b[ROWS] = b[RADIUS_AT] = 0
                    give_up(s)
                    return
            watch_returns(s, t)
            keep_count(s)
            look_ahead(s, t)
        else:
            if not foresee(s, grown(s), t, True):
                foresee(s, b[NOTICED], t, False)
            watch_returns(s, t)
        if t - b[LAST] >= b[QUIET] and not under_way(s, t):
            finish(s, False)
    else:
        watch_returns(s, t)


@kernel
def anticipate(s: Memory, t: int) -> None:
    """Too little has been seen for a decision: what repeats is believed, by what is typical so far. Nothing of it stays."""
    b, radius = s.books, s.values[RADIUS]
    band, last = b[BAND], b[LAST]
    if not b[FIXED]:
        if (t - b[SINCE]) % b[EVERY] == 0:
            s.values[EARLY_RADIUS] = typical(s, t)
        s.values[RADIUS] = s.values[EARLY_RADIUS]
    choose_band(s, t)
    b[LAST] = t
    foresee(s, grown(s), t, True)
    s.values[RADIUS], b[BAND], b[LAST] = radius, band, last


@kernel
def open_up(s: Memory, t: int) -> None:
    """There are enough frames with neighbours: an activity is under way, and keeps the radius."""
    b = s.books
    b[OPEN], b[OPENED], b[BEGUN] = 1, t, 0
    i = t
    while s.near[i % s.near.shape[0]] != 1:
        i -= 1
    b[LAST] = i
    first = max(b[SEED], t - b[LAG] + 1)
    while s.near[first % s.near.shape[0]] != 1:
        first += 1
    row, k = s.rows[first % s.rows.shape[0]], b[BAND]
    while row[k] > s.values[RADIUS]:
        k += 1
    b[NOTICED], b[GROWN] = first - k, 0
    tell(s, RADIUS_EVENT, 0, 0, 0, 0, 0, 0)
    tell(s, BELIEVED_EVENT, stamp(s, first - k), stamp(s, t), number_of(s, first - k), 0, 0, 0)


@kernel
def begin(s: Memory) -> None:
    """The open activity's start is sought; later again, when more has come back."""
    b = s.books
    first = grown(s)
    if b[BEGUN] and first >= b[START]:
        return
    b[BEGUN], b[TOLD], b[RETURNED] = 1, 0, 0
    b[START] = first
    b[COUNT] = b[PENDING] = b[CYCLES] = b[OUTINGS] = b[BOUT] = 0
    s.kinds[:], s.values[PRICES] = 0, 0.0
    b[CLUSTER] = -1
    search_from(s, first)
    b[DONE] = first - 1


@kernel
def grown(s: Memory) -> int:
    """Grow backward from the newest frame that has a neighbour to the activity's first."""
    b = s.books
    first, found = b[LAST], 0
    i = b[LAST]
    while i >= oldest(s):
        near = False
        if s.near[i % s.near.shape[0]] != 2 and not at_rest(s, i):
            for k in range(b[BAND], min(b[LAG], b[LAST] - i) + 1):
                if s.rows[(i + k) % s.rows.shape[0], k] <= s.values[RADIUS]:
                    near = True
                    break
        if near:
            first = i
            found += 1
        elif first - i >= b[QUIET] and found >= b[MASS]:
            break
        i -= 1
    return int(first)


@kernel
def counts(s: Memory) -> bool:
    """Whether the open activity is one: it comes back to itself, or motion has repeated lately. Else it is part of a stretch."""
    return bool(s.books[RETURNED] or s.books[REPEATED] >= s.books[NEXT])


@kernel
def oldest(s: Memory) -> int:
    """The first frame that the open activity may begin with: what it is decided from must still be there."""
    b = s.books
    return int(max(b[SEED], b[OPENED] - 2 * b[LAG]))


@kernel
def finish(s: Memory, forced: bool) -> None:
    """The activity ends with its last frame that has a neighbour, or with a repetition that was accepted while it was open."""
    b = s.books
    if b[MODE] == SEARCH and not b[TOLD]:
        length = cycle_length(s, b[DONE], True)
        if length:
            take_up(s, b[DONE], length)
    if not b[TOLD] and not counts(s):
        b[OPEN] = b[BEGUN] = b[ROWS] = b[RADIUS_AT] = 0
        give_up(s)
        return
    if not b[TOLD]:
        tell_start(s)
    last = b[LAST]
    if b[BEST_END] >= 0 and b[MODE] == TRACK and b[BEST_START] <= last:
        accept(s)
    if b[PENDING]:
        settle(s, min(b[TO], last))
    close_bout(s)
    conclude(s, b[CYCLES] + b[OUTINGS] + believe_behind(s, last))
    forget_returns(s)
    hold(s, last, s.times[last % s.times.shape[0]], how(s) + forced)
    b[OPEN] = b[BEGUN] = b[ROWS] = 0
    b[SEED] = b[UNTOLD] = last + 1
    b[UNTOLD_AT] = s.times[(last + 1) % s.times.shape[0]]
    b[RADIUS_AT] = 0


@kernel
def end(s: Memory) -> None:
    """The stream ends, or a gap follows: what is open closes by force, and all but the exemplars is forgotten."""
    b = s.books
    tell_rest(s)
    b[RECENT] = b[STOOD] = b[UNSEEN] = 0
    close_all(s, True)
    b[SINCE] = b[NEXT]
    b[REPEATED] = 0


@kernel
def stand(s: Memory) -> None:
    """Somebody has rested, or not been seen, for as long as a cycle may last: what is open closes. What the motion was like stays known."""
    close_all(s, False)


@kernel
def close_all(s: Memory, forced: bool) -> None:
    """What is open closes, with the newest frame that was worked through."""
    b = s.books
    newest = b[NEXT] - 1
    if b[NEXT] == b[SINCE]:
        return
    if b[OPEN]:
        if not b[BEGUN]:
            begin(s)
        while b[DONE] < newest:
            b[DONE] += 1
            explore(s, b[DONE])
        finish(s, forced)
    elif b[BELIEVED]:
        give_up(s)
    let_go(s)
    if b[UNTOLD] <= newest:
        stretch(s, newest, forced)
    elif b[BELIEVED]:
        conclude(s, 0)
    forget_returns(s)
    b[SEED] = b[UNTOLD] = b[NEXT]
    b[RADIUS_AT] = b[ROWS] = 0
