"""What was believed is compared with what is believed now, or decided, and corrected where it differs."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.events import tell
from kinegraph.operators.segmentation.kernels.layout import (
    BELIEVED_EVENT,
    COUNT_EVENT,
    Memory,
)
from kinegraph.stream.kernel import kernel

APART = 29
"""Repetitions of this many numbers of activities that follow one another are remembered side by side, until others take their places."""


@kernel
def tell_span(s: Memory, onset: int, end: int, activity: int, number: int) -> None:
    """A repetition has these stamps, as far as is known: reported, if it has not been reported with them."""
    span = s.spans[(APART * activity + number) % s.spans.shape[0]]
    if span[0] != activity or span[1] != number or span[2] != onset or span[3] != end:
        span[0], span[1], span[2], span[3] = activity, number, onset, end
        tell(s, BELIEVED_EVENT, onset, end, activity, number, 0, 0)


@kernel
def tell_count(s: Memory, activity: int, count: int) -> None:
    """This many repetitions have come in the activity: every number is reported once, and a lower one than the last is a correction. None
    of an activity that is merely believed is certain."""
    place, first = activity % s.counted.shape[0], s.event_count
    if count < s.counted[place]:
        tell(s, COUNT_EVENT, activity, count, 0, 0, 0, 0)
    for k in range(s.counted[place] + 1, count + 1):
        tell(s, COUNT_EVENT, activity, k, 0, 0, 0, 0)
    if activity != s.activity:
        s.ratings[first : s.event_count] = 0.0
    s.counted[place] = count


@kernel
def settle_count(s: Memory, activity: int, count: int) -> None:
    """An activity is reported with this many repetitions: what was believed under its number of another one is no longer so."""
    tell_count(s, activity, count)
    s.counted[activity % s.counted.shape[0]] = 0
    if s.believed_of == activity:
        s.believed = 0


@kernel
def forget_returns(s: Memory) -> None:
    """What nothing final covers begins elsewhere: excursions there are looked for once more."""
    s.back, s.back_to = 0, -1
