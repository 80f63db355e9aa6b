"""What is final of an activity is reported: its start, its repetitions or their steps, and what is none."""

from __future__ import annotations

from kinegraph.operators.segmentation.kernels.bouts import join
from kinegraph.operators.segmentation.kernels.clusters import alike
from kinegraph.operators.segmentation.kernels.corrections import forget_returns, settle_count, tell_span
from kinegraph.operators.segmentation.kernels.division import divide
from kinegraph.operators.segmentation.kernels.events import stamp, tell
from kinegraph.operators.segmentation.kernels.excursions import tell_excursions
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY,
    ACTIVITY_EVENT,
    BEGIN_EVENT,
    CLUSTER,
    COUNT,
    CYCLES,
    FARTHEST,
    FROM,
    LIKE,
    MERGE_EVENT,
    NEXT,
    NUMBER,
    OPEN,
    OUTINGS,
    PENDING,
    PIECES_AT,
    PIECES_FROM,
    PRICE,
    PRICES,
    PRIMITIVE_EVENT,
    RADIUS,
    REPEATED,
    SLOT,
    START,
    START_AT,
    TOLD,
    TOLD_TO,
    UNTOLD,
    UNTOLD_AT,
    WINDOW,
    Memory,
)
from kinegraph.operators.segmentation.kernels.separation import gaps
from kinegraph.operators.segmentation.kernels.symmetry import leader, symmetry
from kinegraph.stream.kernel import kernel


@kernel
def settle(s: Memory, last: int) -> None:
    """The pending repetition ends at `last`: it is reported, and compared with another cluster's exemplar."""
    b = s.books
    b[CYCLES] += 1
    s.values[PRICES] += s.values[PRICE]
    if b[CYCLES] > 1:
        b[REPEATED] = b[NEXT] + b[WINDOW]
    b[PENDING] = 0
    b[LIKE] += 1
    s.values[FARTHEST] = max(s.values[FARTHEST], s.values[PRICE])
    join(s, stamp(s, b[FROM]), stamp(s, last))
    slot = b[SLOT]
    tell_span(s, stamp(s, b[FROM]), stamp(s, last), b[ACTIVITY], b[CYCLES] + b[OUTINGS])
    kind, half = symmetry(s, slot, b[FROM], last + 1)
    s.kinds[kind] += 1
    if half >= 0:
        side = leader(s, slot, b[FROM], half, last + 1)
        tell_step(s, b[FROM], half - 1, side)
        tell_step(s, half, last, 3 - side)
    else:
        tell_step(s, b[FROM], last, 0)
    told_to(s, last)
    other = alike(s, slot, b[FROM], last)
    if other >= 0:
        gone, stays = (slot, other) if s.clusters[slot, NUMBER] > s.clusters[other, NUMBER] else (other, slot)
        tell(s, MERGE_EVENT, s.clusters[gone, NUMBER], s.clusters[stays, NUMBER], 0, 0, 0, 0)
        if gone == slot:
            s.clusters[slot, NUMBER], s.clusters[other, NUMBER] = s.clusters[other, NUMBER], -1
            b[CLUSTER] = s.clusters[slot, NUMBER]
        else:
            s.clusters[other, NUMBER] = -1


@kernel
def tell_step(s: Memory, first: int, last: int, side: int) -> None:
    """A repetition, or one side's step of it, is reported."""
    b = s.books
    tell(
        s,
        PRIMITIVE_EVENT,
        stamp(s, first),
        stamp(s, last),
        b[ACTIVITY],
        b[CYCLES] + b[OUTINGS],
        b[CLUSTER],
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
    b = s.books
    b[TOLD_TO] = stamp(s, last)
    b[PIECES_FROM], b[PIECES_AT] = last + 1, s.times[(last + 1) % s.times.shape[0]]


@kernel
def piece(s: Memory, last: int, forced: bool) -> None:
    """A part of an activity that is no repetition."""
    b = s.books
    found = tell_excursions(s, last, b[ACTIVITY], b[CYCLES] + b[OUTINGS], s.values[RADIUS])
    b[OUTINGS] += found
    b[COUNT] += found
    if b[PIECES_FROM] <= last:
        tell(s, PRIMITIVE_EVENT, b[PIECES_AT], stamp(s, last), b[ACTIVITY], 0, -1, forced)
        told_to(s, last)


@kernel
def tell_start(s: Memory) -> None:
    """The activity's start is decided; what lies before it belongs to the one before, or is a stretch of its own."""
    b = s.books
    divide(s)
    first = b[START]
    b[START_AT] = b[UNTOLD_AT] if first == b[UNTOLD] else s.times[first % s.times.shape[0]]
    b[TOLD] = 1
    forget_returns(s)
    if first > b[UNTOLD]:
        stretch(s, first - 1, False)
    b[PIECES_FROM], b[PIECES_AT] = first, b[START_AT]
    tell(s, BEGIN_EVENT, b[START_AT], b[ACTIVITY], 0, 0, 0, 0)


STRETCH = 2
"""Added to `forced` in an activity's event that is a stretch between activities."""


@kernel
def stretch(s: Memory, last: int, forced: bool) -> None:
    """What lies between activities, from UNTOLD to `last`, repeats nothing: one primitive, or where it falls into several, one each."""
    b = s.books
    parted = 0
    if b[OPEN] or b[REPEATED] >= b[NEXT]:
        for cut in gaps(s, b[UNTOLD], last + 1, s.values[RADIUS]):
            passage(s, cut - 1, 0)
            b[UNTOLD], b[UNTOLD_AT] = cut, s.times[cut % s.times.shape[0]]
            parted = 1
    passage(s, last, forced if parted else STRETCH + forced)


@kernel
def passage(s: Memory, last: int, how: int) -> None:
    """Frames UNTOLD to `last` are an activity that repeats nothing."""
    b = s.books
    onset, stop = b[UNTOLD_AT], s.times[last % s.times.shape[0]]
    b[PIECES_FROM], b[PIECES_AT] = b[UNTOLD], onset
    found = tell_excursions(s, last, b[ACTIVITY], 0, s.values[RADIUS])
    if b[PIECES_FROM] <= last:
        tell(s, PRIMITIVE_EVENT, b[PIECES_AT], stop, b[ACTIVITY], 0, -1, how & 1)
    settle_count(s, b[ACTIVITY], found)
    tell(s, ACTIVITY_EVENT, onset, stop, b[ACTIVITY], found, -1, how if not found else how & 1)
    b[ACTIVITY] += 1
