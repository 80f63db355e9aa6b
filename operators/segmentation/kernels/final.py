"""What is final of an activity is reported: its start, its repetitions or their steps, and what is none."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.bouts import join
from kinegraph.operators.segmentation.kernels.clusters import alike
from kinegraph.operators.segmentation.kernels.corrections import forget_returns, settle_count, tell_span
from kinegraph.operators.segmentation.kernels.division import divide
from kinegraph.operators.segmentation.kernels.events import stamp, tell
from kinegraph.operators.segmentation.kernels.excursions import tell_excursions
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY_EVENT,
    BEGIN_EVENT,
    MERGE_EVENT,
    PRIMITIVE_EVENT,
    Memory,
)
from kinegraph.operators.segmentation.kernels.symmetry import leader, symmetry
from kinegraph.stream.kernel import kernel


@kernel
def settle(s: Memory, last: int) -> None:
    """The pending repetition ends at `last`: it is reported, and compared with another cluster's exemplar."""
    s.cycles += 1
    s.prices += s.price
    if s.cycles > 1:
        s.repeated_until = s.next_frame + s.window
    s.is_pending = False
    s.like_count += 1
    s.farthest = max(s.farthest, s.price)
    join(s, stamp(s, s.pending_from), stamp(s, last))
    slot = s.slot
    tell_span(s, stamp(s, s.pending_from), stamp(s, last), s.activity, s.cycles + s.outings)
    kind, half = symmetry(s, slot, s.pending_from, last + 1)
    s.kinds[kind] += 1
    if half >= 0:
        side = leader(s, slot, s.pending_from, half, last + 1)
        tell_step(s, s.pending_from, half - 1, side)
        tell_step(s, half, last, 3 - side)
    else:
        tell_step(s, s.pending_from, last, 0)
    told_to(s, last)
    other = alike(s, slot, s.pending_from, last)
    if other >= 0:
        gone, stays = (slot, other) if s.cluster_numbers[slot] > s.cluster_numbers[other] else (other, slot)
        tell(s, MERGE_EVENT, s.cluster_numbers[gone], s.cluster_numbers[stays], 0, 0, 0, 0)
        if gone == slot:
            s.cluster_numbers[slot], s.cluster_numbers[other] = s.cluster_numbers[other], -1
            s.cluster = s.cluster_numbers[slot]
        else:
            s.cluster_numbers[other] = -1


@kernel
def tell_step(s: Memory, first: int, last: int, side: int) -> None:
    """A repetition, or one side's step of it, is reported."""
    tell(
        s,
        PRIMITIVE_EVENT,
        stamp(s, first),
        stamp(s, last),
        s.activity,
        s.cycles + s.outings,
        s.cluster,
        SIDED * side,
    )


SIDED = 2
"""Times the side: added to `forced` in a primitive's event."""


@kernel
def how(s: Memory) -> int:
    """The activity's symmetry, that of most of its repetitions, as it is reported with `forced`."""
    most = 0
    for kind in range(1, 4):
        if s.kinds[kind] > (s.kinds[most] if most else 0):
            most = kind
    return SYMMETRIC * most


SYMMETRIC = 4
"""Times the symmetry: added to `forced` in an activity's event."""


@kernel
def told_to(s: Memory, last: int) -> None:
    """Primitives are reported up to frame `last`."""
    s.reported_to = stamp(s, last)
    s.pieces_from, s.pieces_at = last + 1, s.times[(last + 1) % s.times.shape[0]]


@kernel
def piece(s: Memory, last: int, forced: bool) -> None:
    """A part of an activity that is no repetition."""
    found = tell_excursions(s, last, s.activity, s.cycles + s.outings, s.radius)
    s.outings += found
    s.count += found
    if s.pieces_from <= last:
        tell(s, PRIMITIVE_EVENT, s.pieces_at, stamp(s, last), s.activity, 0, -1, forced)
        told_to(s, last)


@kernel
def tell_start(s: Memory) -> None:
    """The activity's start is decided; what lies before it belongs to the one before, or is a stretch of its own."""
    divide(s)
    first = s.start
    s.start_at = s.unreported_at if first == s.unreported else s.times[first % s.times.shape[0]]
    s.is_start_final = True
    forget_returns(s)
    if first > s.unreported:
        stretch(s, first - 1, False)
    s.pieces_from, s.pieces_at = first, s.start_at
    tell(s, BEGIN_EVENT, s.start_at, s.activity, 0, 0, 0, 0)


STRETCH = 2
"""Added to `forced` in an activity's event that is a stretch between activities."""


@kernel
def stretch(s: Memory, last: int, forced: bool) -> None:
    """Frames `unreported` to `last`, between activities, repeat nothing, unless they hold gestures from a resting pose."""
    onset, stop = s.unreported_at, s.times[last % s.times.shape[0]]
    s.pieces_from, s.pieces_at = s.unreported, onset
    found = tell_excursions(s, last, s.activity, 0, s.radius)
    if s.pieces_from <= last:
        tell(s, PRIMITIVE_EVENT, s.pieces_at, stop, s.activity, 0, -1, forced)
    settle_count(s, s.activity, found)
    tell(s, ACTIVITY_EVENT, onset, stop, s.activity, found, -1, forced if found else STRETCH + forced)
    s.activity += 1
