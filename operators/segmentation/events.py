"""Events as rows of a table: what kernels tell, and when the frames were that they speak of."""

from __future__ import annotations

from operators.segmentation.layout import EVENTS, NOW, RADIUS, START, START_AT, TOLD, UNTOLD, UNTOLD_AT, Memory
from stream.kernel import kernel


@kernel
def tell(s: Memory, kind: int, a: int, c: int, d: int, e: int, f: int, g: int) -> None:
    """Write an event: its kind, the stamp of the frame that decided it, six numbers; and the radius of that moment."""
    at, events = s.books[EVENTS], s.events
    events[at, 0], events[at, 1] = kind, s.books[NOW]
    events[at, 2], events[at, 3], events[at, 4], events[at, 5], events[at, 6], events[at, 7] = a, c, d, e, f, g
    s.radii[at] = s.values[RADIUS]
    s.books[EVENTS] = at + 1


@kernel
def stamp(s: Memory, i: int) -> int:
    """When a frame was; the first one after the last activity, and the activity's first, may have left the window."""
    if i == s.books[UNTOLD]:
        return int(s.books[UNTOLD_AT])
    if i == s.books[START] and s.books[TOLD]:
        return int(s.books[START_AT])
    return int(s.times[i % s.times.shape[0]])
