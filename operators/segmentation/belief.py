"""What is believed before it is final: how many repetitions have come, as they come; the later ones correct the earlier ones."""

from __future__ import annotations

import math

from operators.segmentation.cycles import FAR, first_dip, longest_lag
from operators.segmentation.division import number_of
from operators.segmentation.events import stamp, tell
from operators.segmentation.layout import (
    ACTIVITY,
    BELIEVED,
    BELIEVED_EVENT,
    BELIEVED_OF,
    BEST_END,
    BEST_START,
    COUNT,
    COUNT_EVENT,
    FROM,
    LENGTH,
    MASS,
    MODE,
    PENDING,
    RADIUS,
    TRACK,
    Memory,
)
from stream.kernel import kernel


@kernel
def believe(s: Memory, activity: int, count: int) -> None:
    """This many repetitions have come in the activity: every number is reported once, and a lower one than the last is a correction."""
    b = s.books
    if b[BELIEVED_OF] != activity:
        if b[BELIEVED]:
            tell(s, COUNT_EVENT, b[BELIEVED_OF], 0, 0, 0, 0, 0)
        b[BELIEVED_OF], b[BELIEVED] = activity, 0
    if count < b[BELIEVED]:
        tell(s, COUNT_EVENT, activity, count, 0, 0, 0, 0)
    for k in range(b[BELIEVED] + 1, count + 1):
        tell(s, COUNT_EVENT, activity, k, 0, 0, 0, 0)
    b[BELIEVED] = count


@kernel
def conclude(s: Memory, count: int) -> None:
    """The open activity has ended with `count` repetitions: the next one begins with none."""
    b = s.books
    believe(s, b[ACTIVITY] if count else b[BELIEVED_OF], count)
    b[BELIEVED] = 0


@kernel
def keep_count(s: Memory) -> None:
    """The repetitions of the activity that is followed: those accepted, and the best path, unless it is to replace the last one."""
    b = s.books
    if b[MODE] == TRACK:
        believe(s, b[ACTIVITY], b[COUNT] + (b[BEST_END] >= 0 and not replaces(s)))


@kernel
def replaces(s: Memory) -> bool:
    """Whether the best path starts within half a cycle of the pending repetition: only one of the two is one."""
    b = s.books
    return bool(b[PENDING] and b[BEST_START] - b[FROM] < b[LENGTH] // 2)


@kernel
def foresee(s: Memory, first: int, t: int) -> None:
    """Nothing is decided of the open activity, which began about frame `first`: its repetitions, if it has a cycle by frame `t`."""
    b = s.books
    last = longest_lag(s, t - first + 1)
    if not last:
        return
    for k in range(1, last + 1):
        n = min(max(k, b[MASS]), t - first + 1 - k)
        total = 0.0
        for i in range(t - n + 1, t + 1):
            far = s.rows[i % s.rows.shape[0], k]
            total += far if far < math.inf else FAR * s.values[RADIUS]
        s.scratch[k] = total / n
    length = first_dip(s, last, False)[0]
    if length:
        activity = number_of(s, first)
        told = b[BELIEVED] if b[BELIEVED_OF] == activity else 0
        for k in range(told, (t - first + 1) // length):
            onset = first + k * length
            tell(s, BELIEVED_EVENT, stamp(s, onset), stamp(s, onset + length - 1), activity, k + 1, 0, 0)
            believe(s, activity, k + 1)
