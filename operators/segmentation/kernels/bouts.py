"""Repetitions that follow one another without a pause as long as one of them: the bout, a second level between action and repetition."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.events import tell
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY,
    BOUT,
    BOUT_AT,
    BOUT_COUNT,
    BOUT_EVENT,
    BOUT_TO,
    CLUSTER,
    LENGTH,
    PERIOD,
    Memory,
)
from kinegraph.stream.kernel import kernel


@kernel
def join(s: Memory, onset: int, end: int) -> None:
    """A repetition is reported, with these stamps."""
    b = s.books
    if not b[BOUT_COUNT]:
        b[BOUT_AT] = onset
    b[BOUT_COUNT] += 1
    b[BOUT_TO] = end


@kernel
def part(s: Memory, start: int) -> None:
    """The next repetition starts with frame `start`: if that is more than a cycle later, rests included, the bout is over."""
    pause = s.times[start % s.times.shape[0]] - s.books[BOUT_TO]
    if pause > (s.books[LENGTH] + 1.5) * s.books[PERIOD]:
        close_bout(s)


@kernel
def close_bout(s: Memory) -> None:
    b = s.books
    if b[BOUT_COUNT]:
        b[BOUT] += 1
        tell(s, BOUT_EVENT, b[BOUT_AT], b[BOUT_TO], b[ACTIVITY], b[BOUT], b[BOUT_COUNT], b[CLUSTER])
        b[BOUT_COUNT] = 0
