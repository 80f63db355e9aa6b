"""Gestures from a resting pose are believed as they come back to it, where nothing else has been reported or believed."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.corrections import tell_span
from kinegraph.operators.segmentation.kernels.division import number_of
from kinegraph.operators.segmentation.kernels.events import stamp
from kinegraph.operators.segmentation.kernels.excursions import excursions
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY,
    AHEAD,
    BACK,
    BACK_FROM,
    BACK_TO,
    BEGUN,
    BELIEVED,
    BELIEVED_OF,
    BEST_END,
    BEST_START,
    COUNT,
    CYCLES,
    FORESEEN,
    LAG,
    LENGTH,
    MASS,
    MODE,
    NOTICED,
    OPEN,
    OUTINGS,
    PENDING,
    PIECES_FROM,
    QUIET,
    RADIUS,
    START,
    TO,
    TOLD,
    TRACK,
    UNTOLD,
    Memory,
)
from kinegraph.operators.segmentation.kernels.provisional import believe, replaces
from kinegraph.stream.kernel import kernel

LOOKS = 3
"""This often within QUIET it is looked for excursions that have come back."""


@kernel
def watch_returns(s: Memory, t: int) -> None:
    """Excursions up to frame `t` of which nothing has been said are believed, as soon as there are two that are alike.

    They are looked for in what nothing final covers, back to two of the longest cycles.
    """
    b = s.books
    if b[AHEAD] or (t % max(1, b[QUIET] // LOOKS) and b[BACK_TO] >= 0):
        return
    first, last = ground(s, t)
    b[BACK_TO] = max(b[BACK_TO], first - 1, 0)
    if last - first < b[MASS]:
        return
    found = excursions(s, first, last, s.values[RADIUS])
    for k in range(len(found)):
        onset, end = found[k, 0], found[k, 1]
        middle = (onset + end) // 2
        if middle > b[BACK_TO]:
            if decided(s):
                believe_piece(s, onset, end)
            else:
                believe_stretch(s, onset, end)


@kernel
def ground(s: Memory, t: int) -> tuple[int, int]:
    """First and last of the frames up to `t` of which nothing is reported: behind the last repetition, and before one that is believed."""
    b = s.books
    first, last = b[UNTOLD], t
    if decided(s):
        first = max(b[PIECES_FROM], b[TO] + 1 if b[PENDING] else 0)
        if b[MODE] == TRACK:
            if b[BEST_END] >= 0:
                last = b[BEST_START] - 1
            elif t - first < b[LENGTH]:
                last = first - 1
    return max(first, t - 2 * b[LAG]), last


@kernel
def decided(s: Memory) -> bool:
    """Whether an activity is open whose start is reported."""
    return bool(s.books[OPEN] and s.books[BEGUN] and s.books[TOLD])


@kernel
def believe_piece(s: Memory, onset: int, end: int) -> None:
    """An excursion in the open activity, beside its cycles."""
    b = s.books
    more = 0
    if b[MODE] == TRACK:
        more = int(b[BEST_END] >= 0 and not replaces(s))
    elif b[BELIEVED_OF] == b[ACTIVITY]:
        before = b[BELIEVED] - b[COUNT]
        if (onset + end) // 2 > b[FORESEEN]:
            b[BACK] = max(b[BACK], before)
        more = max(0, before - b[BACK] - 1)
    came_back(s, onset, end)
    tell_span(s, stamp(s, onset), stamp(s, end), b[ACTIVITY], b[COUNT] + b[BACK])
    believe(s, b[ACTIVITY], b[COUNT] + b[BACK] + more)


@kernel
def believe_stretch(s: Memory, onset: int, end: int) -> None:
    """An excursion of which it is not decided yet what activity it belongs to, unless a cycle has been believed there."""
    b = s.books
    first, activity = b[START] if b[BEGUN] else b[NOTICED], b[ACTIVITY]
    if b[OPEN] and (onset + end) // 2 >= first:
        activity = number_of(s, first)
    if b[BELIEVED_OF] != activity:
        if b[BELIEVED] and not b[BACK]:
            return
        believe(s, activity, 0)
        b[BACK] = 0
    elif b[BELIEVED] and (onset + end) // 2 <= b[FORESEEN]:
        return
    b[BACK] = max(b[BACK], b[BELIEVED])
    came_back(s, onset, end)
    tell_span(s, stamp(s, onset), stamp(s, end), activity, b[BACK])
    believe(s, activity, b[BACK])


@kernel
def believe_behind(s: Memory, last: int) -> int:
    """The open activity ends with frame `last`: excursions behind its last repetition; how many there are."""
    b = s.books
    if b[PIECES_FROM] > last:
        return 0
    found = excursions(s, b[PIECES_FROM], last, s.values[RADIUS])
    for k in range(len(found)):
        number = b[CYCLES] + b[OUTINGS] + k + 1
        tell_span(s, stamp(s, found[k, 0]), stamp(s, found[k, 1]), b[ACTIVITY], number)
    return len(found)


@kernel
def came_back(s: Memory, onset: int, end: int) -> None:
    b = s.books
    b[BACK] += 1
    b[BACK_FROM], b[BACK_TO] = onset, end
    b[FORESEEN] = max(b[FORESEEN], end)
