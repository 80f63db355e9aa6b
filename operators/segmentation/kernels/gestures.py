"""Gestures from a resting pose are believed as they come back to it, where nothing else has been reported or believed."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.corrections import tell_span
from kinegraph.operators.segmentation.kernels.division import number_of
from kinegraph.operators.segmentation.kernels.events import stamp
from kinegraph.operators.segmentation.kernels.excursions import excursions
from kinegraph.operators.segmentation.kernels.layout import (
    Memory,
)
from kinegraph.operators.segmentation.kernels.provisional import believe, replaces
from kinegraph.stream.kernel import kernel

LOOKS = 3
"""This often within `quiet` it is looked for excursions that have come back."""


@kernel
def watch_returns(s: Memory, t: int) -> None:
    """Excursions up to frame `t` of which nothing has been said are believed, as soon as there are two that are alike.

    They are looked for in what nothing final covers, back to two of the longest cycles.
    """
    if s.ahead or (t % max(1, s.quiet // LOOKS) and s.back_to >= 0):
        return
    first, last = ground(s, t)
    s.back_to = max(s.back_to, first - 1, 0)
    if last - first < s.mass:
        return
    found = excursions(s, first, last, s.radius)
    for k in range(len(found)):
        onset, end = found[k, 0], found[k, 1]
        middle = (onset + end) // 2
        if middle > s.back_to:
            if decided(s):
                believe_piece(s, onset, end)
            else:
                believe_stretch(s, onset, end)


@kernel
def ground(s: Memory, t: int) -> tuple[int, int]:
    """First and last of the frames up to `t` of which nothing is reported: behind the last repetition, and before one that is believed."""
    first, last = s.unreported, t
    if decided(s):
        first = max(s.pieces_from, s.pending_to + 1 if s.is_pending else 0)
        if s.is_tracking:
            if s.best_end >= 0:
                last = s.best_start - 1
            elif t - first < s.length:
                last = first - 1
    return max(first, t - 2 * s.max_lag), last


@kernel
def decided(s: Memory) -> bool:
    """Whether an activity is open whose start is reported."""
    return bool(s.is_open and s.is_begun and s.is_start_final)


@kernel
def believe_piece(s: Memory, onset: int, end: int) -> None:
    """An excursion in the open activity, beside its cycles."""
    more = 0
    if s.is_tracking:
        more = int(s.best_end >= 0 and not replaces(s))
    elif s.believed_of == s.activity:
        before = s.believed - s.count
        if (onset + end) // 2 > s.foreseen:
            s.back = max(s.back, before)
        more = max(0, before - s.back - 1)
    came_back(s, onset, end)
    tell_span(s, stamp(s, onset), stamp(s, end), s.activity, s.count + s.back)
    believe(s, s.activity, s.count + s.back + more)


@kernel
def believe_stretch(s: Memory, onset: int, end: int) -> None:
    """An excursion of which it is not decided yet what activity it belongs to, unless a cycle has been believed there."""
    first, activity = s.start if s.is_begun else s.noticed, s.activity
    if s.is_open and (onset + end) // 2 >= first:
        activity = number_of(s, first)
    if s.believed_of != activity:
        if s.believed and not s.back:
            return
        believe(s, activity, 0)
        s.back = 0
    elif s.believed and (onset + end) // 2 <= s.foreseen:
        return
    s.back = max(s.back, s.believed)
    came_back(s, onset, end)
    tell_span(s, stamp(s, onset), stamp(s, end), activity, s.back)
    believe(s, activity, s.back)


@kernel
def believe_behind(s: Memory, last: int) -> int:
    """The open activity ends with frame `last`: excursions behind its last repetition; how many there are."""
    if s.pieces_from > last:
        return 0
    found = excursions(s, s.pieces_from, last, s.radius)
    for k in range(len(found)):
        number = s.cycles + s.outings + k + 1
        tell_span(s, stamp(s, found[k, 0]), stamp(s, found[k, 1]), s.activity, number)
    return len(found)


@kernel
def came_back(s: Memory, onset: int, end: int) -> None:
    s.back += 1
    s.back_from, s.back_to = onset, end
    s.foreseen = max(s.foreseen, end)
