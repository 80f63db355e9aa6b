"""What is believed before it is final: how many repetitions have come, as they come; the later ones correct the earlier ones."""

from __future__ import annotations

import math

from kinegraph.operators.segmentation.kernels.corrections import tell_count, tell_span
from kinegraph.operators.segmentation.kernels.cycles import FAR, TRUSTS, first_dip, longest_lag
from kinegraph.operators.segmentation.kernels.division import number_of
from kinegraph.operators.segmentation.kernels.events import stamp
from kinegraph.operators.segmentation.kernels.layout import (
    Memory,
)
from kinegraph.stream.kernel import kernel

RISES = 2
"""A cycle is believed as soon as frames lie farther apart at this many longer lags."""


@kernel
def believe(s: Memory, activity: int, count: int) -> None:
    """This many repetitions have come in the activity, and none in the one of which that was believed until now, unless they were
    excursions in an earlier one."""
    if s.believed_of != activity:
        if s.believed and not (s.back and s.believed_of < activity):
            tell_count(s, s.believed_of, 0)
        s.believed_of = activity
    tell_count(s, activity, count)
    s.believed = count


@kernel
def conclude(s: Memory, count: int) -> None:
    """The open activity has ended with `count` repetitions: the next one begins with none, or with those that are believed of it."""
    if count or s.believed:
        believe(s, s.activity if count else s.believed_of, count)
    s.believed = 0
    if s.ahead:
        s.believed_of, s.believed, s.ahead = s.activity + 1, s.ahead, 0


@kernel
def give_up(s: Memory) -> None:
    """The open activity is none: of what is believed of it excursions remain, in a stretch."""
    if s.back:
        believe(s, s.activity, s.back)
    else:
        conclude(s, 0)


@kernel
def is_last_return(s: Memory) -> bool:
    """Whether the best path is the newest excursion that is believed."""
    return bool(s.back and s.best_start <= (s.back_from + s.back_to) // 2)


@kernel
def keep_count(s: Memory) -> None:
    """The repetitions of the activity that is followed: those accepted, excursions, and the best path, unless it replaces the last one."""
    if s.is_tracking:
        believe_open(s, s.count + s.back + (s.best_end >= 0 and not replaces(s)))


@kernel
def believe_open(s: Memory, count: int) -> None:
    """This many repetitions have come in the open activity; if that is one more, what was believed of the next activity was wrong."""
    if s.ahead and count > s.believed:
        tell_count(s, s.activity + 1, 0)
        s.ahead = 0
    believe(s, s.activity, count)


@kernel
def replaces(s: Memory) -> bool:
    """Whether the best path starts within half a cycle of the pending repetition: only one of the two is one."""
    return bool(s.is_pending and s.best_start - s.pending_from < s.length // 2)


@kernel
def foresee(s: Memory, first: int, t: int, grown: bool) -> bool:
    """Nothing is decided of the open activity, which began about frame `first`: its repetitions, if it has a cycle by frame `t`.

    `grown`: it has been grown back to `first`, which corrects what was believed from where it was noticed on.
    """
    length = cycle_by(s, first, t)
    if length:
        first = comes_back(s, first, t, length)
        activity = number_of(s, first)
        if s.believed_of != activity or (grown and not s.is_grown):
            s.foreseen = first - 1
        s.is_grown |= grown
        count = (t - first + 1) // length
        for k in range(count):
            last = first + (k + 1) * length - 1
            if last - s.foreseen > length // 2:
                tell_believed(s, last, length, activity, k + 1)
                s.foreseen = last
        believe(s, activity, max(count, s.believed if s.believed_of == activity else 0))
    return length > 0


@kernel
def look_ahead(s: Memory, t: int) -> None:
    """The open activity's start has been sought. While its cycle is not found, what came back when it was noticed is believed; and when
    its cycle has not come again for longer than it lasts, what repeats since then is believed to be the next activity."""
    if not s.is_tracking:
        if not s.is_start_final:
            foresee(s, s.noticed, t, False)
        return
    first = max(s.pending_to + 1, s.origin)
    if not s.count or s.best_end >= 0 or t - first < s.length:
        return
    length = cycle_by(s, first, t)
    if length:
        for k in range(s.ahead, (t - first + 1) // length):
            tell_believed(s, first + (k + 1) * length - 1, length, s.activity + 1, k + 1)
            tell_count(s, s.activity + 1, k + 1)
            s.ahead = k + 1


@kernel
def cycle_by(s: Memory, first: int, t: int) -> int:
    """The lag at which frames `first` to `t` come back to themselves; 0: they do not."""
    last = longest_lag(s, t - first + 1)
    for k in range(1, last + 1):
        n = min(max(k, s.mass), t - first + 1 - k)
        total = 0.0
        for i in range(t - n + 1, t + 1):
            far = s.rows[i % s.rows.shape[0], k]
            total += far if far < math.inf else FAR * s.radius
        s.scratch[k] = total / n
    return first_dip(s, last, RISES)[0]


@kernel
def comes_back(s: Memory, first: int, t: int, length: int) -> int:
    """The first of the frames `first`, a cycle later, two later, ... from which on a cycle comes back, within TRUSTS radii on the mean."""
    first += length * max(0, (t + length - s.rows.shape[0] - first) // length)
    while first + 2 * length <= t:
        total = 0.0
        for i in range(first + length, first + 2 * length):
            far = s.rows[i % s.rows.shape[0], length]
            total += far if far < math.inf else FAR * s.radius
        if total <= TRUSTS * length * s.radius:
            break
        first += length
    return first


@kernel
def tell_believed(s: Memory, last: int, length: int, activity: int, number: int) -> None:
    tell_span(s, stamp(s, last + 1 - length), stamp(s, last), activity, number)
