"""What is believed before it is final: how many repetitions have come, as they come; the later ones correct the earlier ones."""

from __future__ import annotations

import math

from kinegraph.operators.segmentation.kernels.corrections import tell_count, tell_span
from kinegraph.operators.segmentation.kernels.cycles import FAR, TRUSTS, first_dip, longest_lag, release, track
from kinegraph.operators.segmentation.kernels.division import number_of
from kinegraph.operators.segmentation.kernels.events import stamp
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY,
    AHEAD,
    BACK,
    BACK_FROM,
    BACK_TO,
    BELIEVED,
    BELIEVED_OF,
    BEST_END,
    BEST_START,
    COUNT,
    FORESEEN,
    FROM,
    GROWN,
    LENGTH,
    MASS,
    MODE,
    NOTICED,
    ORIGIN,
    PENDING,
    RADIUS,
    TO,
    TOLD,
    TRACK,
    Memory,
)
from kinegraph.stream.kernel import kernel


@kernel
def believe(s: Memory, activity: int, count: int) -> None:
    """This many repetitions have come in the activity, and none in the one of which that was believed until now, unless they were
    excursions in an earlier one."""
    b = s.books
    if b[BELIEVED_OF] != activity:
        if b[BELIEVED] and not (b[BACK] and b[BELIEVED_OF] < activity):
            tell_count(s, b[BELIEVED_OF], 0)
        b[BELIEVED_OF] = activity
    tell_count(s, activity, count)
    b[BELIEVED] = count


@kernel
def conclude(s: Memory, count: int) -> None:
    """The open activity has ended with `count` repetitions: the next one begins with none, or with those that are believed of it."""
    b = s.books
    if count or b[BELIEVED]:
        believe(s, b[ACTIVITY] if count else b[BELIEVED_OF], count)
    b[BELIEVED] = 0
    if b[AHEAD]:
        b[BELIEVED_OF], b[BELIEVED], b[AHEAD] = b[ACTIVITY] + 1, b[AHEAD], 0


@kernel
def give_up(s: Memory) -> None:
    """The open activity is none: of what is believed of it excursions remain, in a stretch."""
    b = s.books
    if b[BACK]:
        believe(s, b[ACTIVITY], b[BACK])
    else:
        conclude(s, 0)


@kernel
def is_last_return(s: Memory) -> bool:
    """Whether the best path is the newest excursion that is believed."""
    b = s.books
    return bool(b[BACK] and b[BEST_START] <= (b[BACK_FROM] + b[BACK_TO]) // 2)


@kernel
def keep_count(s: Memory) -> None:
    """The repetitions of the activity that is followed: those accepted, excursions, and the best path, unless it replaces the last one."""
    b = s.books
    if b[MODE] == TRACK:
        believe_open(s, b[COUNT] + b[BACK] + (b[BEST_END] >= 0 and not replaces(s)))


@kernel
def believe_open(s: Memory, count: int) -> None:
    """This many repetitions have come in the open activity; if that is one more, what was believed of the next activity was wrong."""
    b = s.books
    if b[AHEAD] and count > b[BELIEVED]:
        tell_count(s, b[ACTIVITY] + 1, 0)
        b[AHEAD] = 0
    believe(s, b[ACTIVITY], count)


@kernel
def expect(s: Memory, i: int) -> None:
    """Frame `i` after the open activity's cycle was given up: where that comes again it is believed, though not yet followed."""
    b = s.books
    fresh = b[BEST_END]
    if track(s, i):
        release(s)
    elif fresh < 0 and b[BEST_END] >= 0:
        number = b[BELIEVED] + (not is_last_return(s))
        tell_span(s, stamp(s, b[BEST_START]), stamp(s, b[BEST_END]), b[ACTIVITY], number)
        believe_open(s, number)
        b[FORESEEN] = max(b[FORESEEN], b[BEST_END])


@kernel
def replaces(s: Memory) -> bool:
    """Whether the best path starts within half a cycle of the pending repetition: only one of the two is one."""
    b = s.books
    return bool(b[PENDING] and b[BEST_START] - b[FROM] < b[LENGTH] // 2)


@kernel
def foresee(s: Memory, first: int, t: int, grown: bool) -> bool:
    """Nothing is decided of the open activity, which began about frame `first`: its repetitions, if it has a cycle by frame `t`.

    `grown`: it has been grown back to `first`, which corrects what was believed from where it was noticed on.
    """
    b = s.books
    length = cycle_by(s, first, t)
    if length:
        first = comes_back(s, first, t, length)
        activity = number_of(s, first)
        if b[BELIEVED_OF] != activity or (grown and not b[GROWN]):
            b[FORESEEN] = first - 1
        b[GROWN] |= grown
        count = (t - first + 1) // length
        for k in range(count):
            last = first + (k + 1) * length - 1
            if last - b[FORESEEN] > length // 2:
                tell_believed(s, last, length, activity, k + 1)
                b[FORESEEN] = last
        believe(s, activity, max(count, b[BELIEVED] if b[BELIEVED_OF] == activity else 0))
    return length > 0


@kernel
def look_ahead(s: Memory, t: int) -> None:
    """The open activity's start has been sought. While its cycle is not found, what came back when it was noticed is believed; and when
    its cycle has not come again for longer than it lasts, what repeats since then is believed to be the next activity."""
    b = s.books
    if b[MODE] != TRACK:
        if not b[TOLD]:
            foresee(s, b[NOTICED], t, False)
        return
    first = max(b[TO] + 1, b[ORIGIN])
    if not b[COUNT] or b[BEST_END] >= 0 or t - first < b[LENGTH]:
        return
    length = cycle_by(s, first, t)
    if length:
        for k in range(b[AHEAD], (t - first + 1) // length):
            tell_believed(s, first + (k + 1) * length - 1, length, b[ACTIVITY] + 1, k + 1)
            tell_count(s, b[ACTIVITY] + 1, k + 1)
            b[AHEAD] = k + 1


@kernel
def cycle_by(s: Memory, first: int, t: int) -> int:
    """The lag at which frames `first` to `t` come back to themselves; 0: they do not."""
    last = longest_lag(s, t - first + 1)
    for k in range(1, last + 1):
        n = min(max(k, s.books[MASS]), t - first + 1 - k)
        total = 0.0
        for i in range(t - n + 1, t + 1):
            far = s.rows[i % s.rows.shape[0], k]
            total += far if far < math.inf else FAR * s.values[RADIUS]
        s.scratch[k] = total / n
    return first_dip(s, last, False)[0]


@kernel
def comes_back(s: Memory, first: int, t: int, length: int) -> int:
    """The first of the frames `first`, a cycle later, two later, ... from which on a cycle comes back, within TRUSTS radii on the mean."""
    first += length * max(0, (t + length - s.rows.shape[0] - first) // length)
    while first + 2 * length <= t:
        total = 0.0
        for i in range(first + length, first + 2 * length):
            far = s.rows[i % s.rows.shape[0], length]
            total += far if far < math.inf else FAR * s.values[RADIUS]
        if total <= TRUSTS * length * s.values[RADIUS]:
            break
        first += length
    return first


@kernel
def tell_believed(s: Memory, last: int, length: int, activity: int, number: int) -> None:
    tell_span(s, stamp(s, last + 1 - length), stamp(s, last), activity, number)
