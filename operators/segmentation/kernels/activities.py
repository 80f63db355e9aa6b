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
    BELIEVED_EVENT,
    RADIUS_EVENT,
    Memory,
)
from kinegraph.operators.segmentation.kernels.provisional import conclude, foresee, give_up, keep_count, look_ahead
from kinegraph.operators.segmentation.kernels.repetitions import accept, explore, search_from, take_up
from kinegraph.operators.segmentation.kernels.rest import (
    at_rest,
    choose_peak,
    reported_at_rest,
    rests,
    tell_rest,
    unseen,
)
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

ROOM = 1024
"""One frame never leads to more events."""


@kernel
def follow(s: Memory, x: Samples, mirrored: Samples, time: Times, first: int, gap: bool) -> int:
    """Work through frames `x` (n, features) with stamps `time` (n,) from row `first` on, while there is room for events.

    mirrored  (n, features)  their mirror images; NaN: not known. (0, features): there are none

    `gap`: what is open ends before row `first`, or now if there is no such row. Returns the row to continue with; `event_count` rows were
    written.
    """
    s.event_count = 0
    if gap:
        if first < x.shape[0]:
            s.now = time[first]
        end(s)
    i = first
    while i < x.shape[0] and s.event_count + 2 * ROOM <= s.events.shape[0]:
        s.now = time[i]
        if rests(s, x[i], time[i]):
            leave_out(s, s.rested)
        elif unseen(s, x[i]):
            leave_out(s, s.unseen - s.rest)
        else:
            t = insert(s, x[i], time[i])
            if mirrored.shape[0]:
                reflect(s, t, mirrored[i])
            step(s, t)
        i += 1
    return i


@kernel
def leave_out(s: Memory, count: int) -> None:
    """The newest `count` frames were left out.

    After a transition no activity can meet the one before. A longer rest is an activity of its own if it follows repetitions, unless they
    have such rests between them; what lasts for `max_lag` ends everything.
    """
    if s.is_parked or s.next_frame == s.since:
        return
    if count == s.max_lag or (count == s.transition + 1 and s.rested and has_repeated(s)):
        stand(s)
    elif count == s.transition + 1 and not s.is_open:
        let_go(s)


@kernel
def has_repeated(s: Memory) -> bool:
    """Whether the activity that is open, or was last, has repetitions without longer rests between them."""
    return bool(not s.is_paused and ((s.is_open and s.count > 1) or (s.is_held and s.held_cycles > 1)))


@kernel
def step(s: Memory, t: int) -> None:
    choose_peak(s, t)
    if t == s.unreported:
        s.unreported_at = s.times[t % s.times.shape[0]]
    if not s.is_open:
        if t - s.since + 1 < s.learn:
            anticipate(s, t)
            return
        if s.believed and t - s.since + 1 >= s.learn + s.mass:
            give_up(s)
        if s.is_held and t - s.held_last > s.max_lag + s.transition:
            let_go(s)
        if t >= s.radius_due:
            choose_radius(s, t)
            s.radius_due = t + s.every
        elif t - s.max_lag >= s.seed:
            s.near_count -= s.near[(t - s.max_lag) % s.near.shape[0]] == 1
        near = mark(s, t, s.seed)
        s.near_count += near
        if near and s.near_count >= s.mass:
            open_up(s, t)
    elif mark(s, t, s.seed):
        s.last = t
    if s.is_open:
        quiet = t - s.last >= s.quiet
        if quiet or t >= s.opened + s.settle:
            sought = s.is_begun and (s.is_start_final or s.has_returned or (t - s.opened) % s.settle)
            if not sought:
                begin(s)
        if s.is_begun:
            while s.done < t:
                s.done += 1
                explore(s, s.done)
            if not s.is_start_final and t >= s.opened + s.firm:
                if counts(s):
                    tell_start(s)
                elif t >= s.start + 2 * s.max_lag:
                    s.is_open = s.is_begun = False
                    s.near_count = s.radius_due = 0
                    give_up(s)
                    return
            watch_returns(s, t)
            keep_count(s)
            look_ahead(s, t)
        else:
            if not foresee(s, grown(s), t, True):
                foresee(s, s.noticed, t, False)
            watch_returns(s, t)
        if t - s.last >= s.quiet:
            finish(s, False)
    else:
        watch_returns(s, t)


@kernel
def anticipate(s: Memory, t: int) -> None:
    """Too little has been seen for a decision: what repeats is believed, by what is typical so far. Nothing of it stays."""
    radius = s.radius
    band, last = s.band, s.last
    if not s.is_radius_fixed:
        if (t - s.since) % s.every == 0:
            s.early_radius = typical(s, t)
        s.radius = s.early_radius
    choose_band(s, t)
    s.last = t
    foresee(s, grown(s), t, True)
    s.radius, s.band, s.last = radius, band, last


@kernel
def open_up(s: Memory, t: int) -> None:
    """There are enough frames with neighbours: an activity is under way, and keeps the radius."""
    s.is_open, s.opened, s.is_begun = True, t, False
    i = t
    while s.near[i % s.near.shape[0]] != 1:
        i -= 1
    s.last = i
    first = max(s.seed, t - s.max_lag + 1)
    while s.near[first % s.near.shape[0]] != 1:
        first += 1
    row, k = s.rows[first % s.rows.shape[0]], s.band
    while row[k] > s.radius:
        k += 1
    s.noticed, s.is_grown = first - k, False
    tell(s, RADIUS_EVENT, 0, 0, 0, 0, 0, 0)
    tell(s, BELIEVED_EVENT, stamp(s, first - k), stamp(s, t), number_of(s, first - k), 0, 0, 0)


@kernel
def begin(s: Memory) -> None:
    """The open activity's start is sought; later again, when more has come back."""
    first = grown(s)
    if s.is_begun and first >= s.start:
        return
    s.is_begun, s.is_start_final, s.has_returned = True, False, False
    s.start = first
    s.is_pending = s.is_paused = False
    s.count = s.cycles = s.outings = s.bout = 0
    s.kinds[:], s.prices = 0, 0.0
    s.cluster = -1
    search_from(s, first)
    s.done = first - 1


@kernel
def grown(s: Memory) -> int:
    """Grow backward from the newest frame that has a neighbour to the activity's first."""
    first, found = s.last, 0
    i = s.last
    while i >= oldest(s):
        near = False
        if s.near[i % s.near.shape[0]] != 2 and not at_rest(s, i):
            for k in range(s.band, min(s.max_lag, s.last - i) + 1):
                if s.rows[(i + k) % s.rows.shape[0], k] <= s.radius:
                    near = True
                    break
        if near:
            first = i
            found += 1
        elif first - i >= s.quiet and found >= s.mass:
            break
        i -= 1
    return int(first)


@kernel
def counts(s: Memory) -> bool:
    """Whether the open activity is one: it comes back to itself, or motion has repeated lately. Else it is part of a stretch."""
    return bool(s.has_returned or s.repeated_until >= s.next_frame)


@kernel
def oldest(s: Memory) -> int:
    """The first frame that the open activity may begin with: what it is decided from must still be there."""
    return int(max(s.seed, s.opened - 2 * s.max_lag))


@kernel
def finish(s: Memory, forced: bool) -> None:
    """The activity ends with its last frame that has a neighbour, or with a repetition that was accepted while it was open."""
    if not s.is_tracking and not s.is_start_final:
        length = cycle_length(s, s.done, True)
        if length:
            take_up(s, s.done, length)
    if not s.is_start_final and not counts(s):
        s.is_open = s.is_begun = False
        s.near_count = s.radius_due = 0
        give_up(s)
        return
    if not s.is_start_final:
        tell_start(s)
    last = s.last
    if s.best_end >= 0 and s.is_tracking and s.best_start <= last:
        accept(s)
    if s.is_pending:
        settle(s, min(s.pending_to, last))
    close_bout(s)
    conclude(s, s.cycles + s.outings + believe_behind(s, last))
    forget_returns(s)
    hold(s, last, s.times[last % s.times.shape[0]], how(s) + forced)
    s.is_open = s.is_begun = False
    s.near_count = 0
    s.seed = s.unreported = last + 1
    s.unreported_at = s.times[(last + 1) % s.times.shape[0]]
    s.radius_due = 0


@kernel
def end(s: Memory) -> None:
    """The stream ends, or a gap follows: what is open closes by force, and all but the exemplars is forgotten."""
    tell_rest(s, True)
    s.has_rested = False
    s.recent_count = s.unseen = 0
    close_all(s, True, s.next_frame)
    s.since = s.next_frame
    s.repeated_until = 0


@kernel
def stand(s: Memory) -> None:
    """Somebody has rested, or not been seen, for long: what is open closes. What the motion was like stays known.

    A rest is the next activity, from the first of its frames on that was worked through before it was noticed.
    """
    stop = s.next_frame
    while s.rested and stop > s.unreported and reported_at_rest(s, stop - 1):
        stop -= 1
    first = close_all(s, False, stop)
    if s.rested:
        s.is_parked = True
        s.parked_at = s.times[first % s.times.shape[0]] if first < s.next_frame else s.rest_from


@kernel
def close_all(s: Memory, forced: bool, stop: int) -> int:
    """What is open closes, with the frame before `stop`; returns the first frame that is in no activity."""
    newest = s.next_frame - 1
    if s.next_frame == s.since:
        return int(s.next_frame)
    if s.is_open:
        if not s.is_begun:
            begin(s)
        while s.done < newest:
            s.done += 1
            explore(s, s.done)
        s.last = max(s.start, min(s.last, stop - 1))
        finish(s, forced)
    elif s.believed:
        give_up(s)
    let_go(s)
    if s.unreported < stop:
        stretch(s, stop - 1, forced)
    elif s.believed:
        conclude(s, 0)
    first = max(stop, s.unreported)
    forget_returns(s)
    s.seed = s.unreported = s.next_frame
    s.radius_due = s.near_count = 0
    return int(first)
