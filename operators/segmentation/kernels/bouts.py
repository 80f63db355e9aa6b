"""Repetitions that follow one another without a pause as long as one of them: the bout, a second level between action and repetition."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.events import tell
from kinegraph.operators.segmentation.kernels.layout import (
    BOUT_EVENT,
    Memory,
)
from kinegraph.stream.kernel import kernel


@kernel
def join(s: Memory, onset: int, end: int) -> None:
    """A repetition is reported, with these stamps."""
    if not s.bout_count:
        s.bout_at = onset
    s.bout_count += 1
    s.bout_to = end


@kernel
def part(s: Memory, start: int) -> None:
    """The next repetition starts with frame `start`: if that is more than a cycle later, rests included, the bout is over."""
    pause = s.times[start % s.times.shape[0]] - s.bout_to
    if pause > (s.length + 1.5) * s.period_ns:
        close_bout(s)


@kernel
def close_bout(s: Memory) -> None:
    if s.bout_count:
        s.bout += 1
        tell(s, BOUT_EVENT, s.bout_at, s.bout_to, s.activity, s.bout, s.bout_count, s.cluster)
        s.bout_count = 0
