"""What a segmentation remembers, and where: one named tuple of flat arrays, so that kernels take one thing."""

from __future__ import annotations

from dataclasses import make_dataclass
from typing import NamedTuple

import numpy as np

from kinegraph.operators.neighbours.layout import Floats
from kinegraph.operators.neighbours.layout import allocate as index_of
from kinegraph.stream.chunk import Array, Samples, Times

NAMES = [
    "LAG", "WINDOW", "LEARN", "QUIET", "MASS", "SETTLE", "FIRM", "BAND_LEAST", "BAND_MOST", "EVERY", "REST", "FIXED",
    "NEXT", "SINCE", "SEED", "UNTOLD", "UNTOLD_AT", "BAND", "RADIUS_AT", "ROWS", "OPEN", "OPENED", "LAST", "BEGUN",
    "RETURNED", "REPEATED", "START", "START_AT", "ACTIVITY", "NOTICED", "GROWN", "AHEAD", "FORESEEN",
    "MODE", "ORIGIN", "DONE", "SLOT", "LENGTH", "FREE", "BEST_START", "BEST_END", "COUNT", "PENDING", "FROM", "TO", "CYCLES",
    "PIECES_FROM", "PIECES_AT", "TOLD_TO", "BOUT", "BOUT_COUNT", "BOUT_AT", "BOUT_TO",
    "CLUSTER", "NEXT_CLUSTER", "CLOCK", "TURN", "EVENTS", "TOLD", "NOW", "PRESENT", "PATCHY",
    "RECENT", "RESTED", "REST_FROM", "REST_TO", "PEAK_AT", "BELIEVED", "BELIEVED_OF", "LIKE",
    "TRANSITION", "RESUMED", "HELD", "HELD_FIRST", "HELD_LAST", "HELD_AT", "HELD_TO", "HELD_CYCLES", "HELD_CLUSTER", "HELD_HOW",
    "KEPT", "OUTINGS", "STOOD", "BACK", "BACK_FROM", "BACK_TO", "UNSEEN", "PERIOD",
]  # fmt: skip
(
    LAG, WINDOW, LEARN, QUIET, MASS, SETTLE, FIRM, BAND_LEAST, BAND_MOST, EVERY, REST, FIXED,
    NEXT, SINCE, SEED, UNTOLD, UNTOLD_AT, BAND, RADIUS_AT, ROWS, OPEN, OPENED, LAST, BEGUN,
    RETURNED, REPEATED, START, START_AT, ACTIVITY, NOTICED, GROWN, AHEAD, FORESEEN,
    MODE, ORIGIN, DONE, SLOT, LENGTH, FREE, BEST_START, BEST_END, COUNT, PENDING, FROM, TO, CYCLES,
    PIECES_FROM, PIECES_AT, TOLD_TO, BOUT, BOUT_COUNT, BOUT_AT, BOUT_TO,
    CLUSTER, NEXT_CLUSTER, CLOCK, TURN, EVENTS, TOLD, NOW, PRESENT, PATCHY,
    RECENT, RESTED, REST_FROM, REST_TO, PEAK_AT, BELIEVED, BELIEVED_OF, LIKE,
    TRANSITION, RESUMED, HELD, HELD_FIRST, HELD_LAST, HELD_AT, HELD_TO, HELD_CYCLES, HELD_CLUSTER, HELD_HOW,
    KEPT, OUTINGS, STOOD, BACK, BACK_FROM, BACK_TO, UNSEEN, PERIOD,
) = range(len(NAMES))  # fmt: skip
"""
LAG                       longest cycle, and how far back neighbours are looked for, in frames; as all down to REST
WINDOW, LEARN             frames that the radius is taken from; how many there must be
QUIET, MASS               frames without a neighbour that end an activity; frames with one that open it
SETTLE, FIRM              how long after its opening an activity's start is sought; and is decided at the latest
BAND_LEAST, BAND_MOST     bounds of the band around the diagonal
EVERY                     frames between two choices of the radius while nothing is open
REST                      frames in which nothing moves, after which a rest is one
FIXED                     whether the radius is given
NEXT, SINCE               number of the next frame; of the first since the start or a gap
SEED                      first frame after the last activity: neighbours are not looked for before it
UNTOLD, UNTOLD_AT         first frame that is part of no activity told, and its stamp
BAND                      frames less far away are no neighbours
RADIUS_AT                 when the radius is chosen next
ROWS                      of the newest LAG frames, how many have a neighbour
OPEN, OPENED, LAST        whether an activity is open, since when; the last frame with a neighbour
BEGUN, TOLD               whether its start has been sought; whether it is decided, and told
RETURNED                  whether the activity has been seen to come back to itself after it had left
REPEATED                  until which frame activities count that do not come back: a window after the last repetition
START, START_AT           the start and its stamp
ACTIVITY                  number of the next activity
MODE                      SEARCH or TRACK
ORIGIN, DONE              where the search for a cycle begins; the last frame worked through
SLOT, LENGTH              which exemplar is tracked, and its length
FREE                      no path starts before this frame
BEST_START, BEST_END      the best path not yet accepted; -1: none
COUNT                     repetitions of the open activity, accepted
PENDING, FROM, TO         whether a repetition waits for its end; its path
PIECES_FROM, PIECES_AT    first frame of the activity not yet told as a primitive, and its stamp
TOLD_TO                   stamp of the frame before that
CYCLES                    repetitions of the open activity, told
BOUT, BOUT_COUNT          bouts of the open activity that were reported; repetitions in the one under way
BOUT_AT, BOUT_TO          its first repetition's onset and its last one's end, stamps
CLUSTER, NEXT_CLUSTER     cluster of the pending repetition; number of the next new one
CLOCK, TURN               counts uses of exemplars; whose turn it is to be compared
EVENTS, NOW               rows written to the table of events; the stamp of what is decided now
PRESENT                   features that have been known within the newest WINDOW frames
PATCHY                    the last frame in which a feature was not known
RECENT                    frames seen since the start or a gap, those at rest included
RESTED                    frames left out by the rest under way; 0: there is none
REST_FROM, REST_TO        stamps of its first and newest frame
PEAK_AT                   when it is judged again how much the liveliest frames move
BELIEVED, BELIEVED_OF     the count told last, and of which activity
NOTICED                   the first frame that had come back when the open activity was noticed
GROWN                     whether repetitions are believed that begin where the open activity was grown back to
FORESEEN                  the last frame of the newest repetition that is believed before its activity has a cycle
AHEAD                     repetitions believed of the activity after the open one
LIKE                      repetitions told since the exemplar was taken up
TRANSITION                frames between two activities, at the most, that are divided between them
RESUMED                   the first frame after the last rest that was longer, or after nothing was known for longer
HELD                      whether an activity has ended whose end is decided with the next one's start
HELD_FIRST, HELD_LAST     its first and last frame, as far as it is known; HELD_AT, HELD_TO: their stamps
HELD_CYCLES, HELD_CLUSTER its repetitions and cluster; HELD_HOW: the last number of its event
KEPT                      frames of exemplars entered so far, those moved on counted again
OUTINGS                   excursions of the open activity, told as repetitions beside its cycles
STOOD                     whether a rest has been told since the start or a gap
BACK                      excursions that are believed, of what nothing final covers
BACK_FROM, BACK_TO        the newest one's first and last frame
UNSEEN                    frames in a row, up to the newest, of which nothing was known
PERIOD                    nominal time from one frame to the next, in ns
"""
SEARCH, TRACK = 0, 1
(
    RADIUS, BEST, FACTOR, PRICE, MOVED, PEAK, STILL_SHARE, TRAVEL_SHARE, FARTHEST, PRICES, HELD_CERTAINTY, HELD_RADIUS,
    EARLY_RADIUS,
) = range(13)  # fmt: skip
"""Places in `values`: the radius, the best path's mean distance, the radius as a share of the median distance, the
pending repetition's mean distance, how much the newest frame moves, and the window's liveliest ones; STILL and TRAVELS; how far those
that are counted in LIKE lie from their exemplar at the most; how far the open activity's repetitions lie from theirs, added up;
how certain those of the activity are whose end is held, and its radius; the radius before LEARN."""

STILL = 0.12
"""Who has moved less than this share of what the window's liveliest frames do, is at rest."""
NOISE = 1.5
"""Noise is this many times the squares of what frames differ by from one to the next: more than once, as it adds up to more at times."""
TRAVELS = 0.5
"""A repetition moves at least this share of how far its exemplar does, from stride to stride: who stands, repeats nothing."""

(
    ACTIVITY_EVENT, PRIMITIVE_EVENT, BEGIN_EVENT, COUNT_EVENT, MERGE_EVENT, RADIUS_EVENT, BELIEVED_EVENT, BOUT_EVENT,
    REST_EVENT, RESTING_EVENT,
) = range(10)  # fmt: skip
EVENT_WIDTH = 8
"""A row of the table of events: kind, stamp of the decision, then what the kind has; see operator.py."""

NUMBER, SIZE, USED, AT, WHOLE = range(5)
"""Columns of `clusters`."""

MOST_CLUSTERS = 256
LONGEST_EXEMPLARS = 24
"""At most MOST_CLUSTERS exemplars are kept, and no more of their frames than LONGEST_EXEMPLARS of LAG frames have."""
RING = 32
"""The ring that holds them, in LAG frames: a third longer, so that few have to be moved on when it goes round."""

NEVER_KNOWN = -(1 << 60)


class Memory(NamedTuple):
    """The arrays that kernels work on.

    frames     (features, 2 ring)  frames by number modulo ring, twice, so that any `ring` in a row stand side by side; NaN: not known
    known      (features,)         the last frame in which each feature was known
    common     (LAG + 1,)          how many features both frames of a distance have
    times      (ring,)             their stamps
    rows       (rows, LAG + 1)     distance of a frame to the one 1, 2, ... LAG before it, by number modulo `rows`
    near       (rows,)             whether a frame has a neighbour;  2: it was bad, and never has
    sums       (rows, LAG + 1)     of a frame's distances at each lag and all before it since ORIGIN
    cost       (2, LAG + 1)        of the best path that ends at each column of the exemplar, of the frame before and of this one
    begin      (2, LAG + 1)        the frame where that path starts
    scratch    (LAG + 1,)          distances of a frame to the exemplar's
    exemplars  (features, RING LAG)  frames of exemplars, by the number with which they were entered, modulo the ring
    owners     (RING LAG,)         the cluster of each, unless it has left since or was moved on
    lookup, lookup_books           these frames in an index: the two arrays of operators/neighbours
    clusters   (clusters, 5)       number (-1: free), length, last use; the number of its first frame; whether all its features are known
    mirrored   (ring, features)    mirror images of frames, by number modulo ring; NaN: not known. (0, features) where there are none
    firsts     (features,)         1: the first of a pair that changes places in the mirror
    leads      (clusters,)         how much more the firsts have moved in the first steps of a cluster's cycles than in the second ones
    recent     (REST, features)    the newest frames as they came, by RECENT modulo REST, and their stamps recent_at (REST,)
    steps      (REST,)             mean square of how much each of them differs from the one before it; NaN: nothing is known of both
    moves      (ring,)             how much each frame moves: see `moved` in rest.py; negative: in a rest that was reported
    travels    (clusters,)         how far the exemplars move, from stride to stride
    kinds      (4,)                repetitions of the open activity by their symmetry
    counted    (8,)                the count reported last, by activity modulo 8, until that is final
    spans      (64, 4)             what was reported last of a repetition: activity, number, onset and end
    books, values                  the numbers named above
    events     (m, EVENT_WIDTH)    what a call leads to; ratings (m,): of a radius its value, of all else how certain the open
                                   activity's repetitions are. Not part of the state
    """

    frames: Samples
    known: Times
    common: Samples
    times: Times
    rows: Samples
    near: Array
    sums: Samples
    cost: Samples
    begin: Times
    scratch: Samples
    exemplars: Samples
    owners: Times
    lookup: Floats
    lookup_books: Times
    clusters: Times
    mirrored: Samples
    firsts: Times
    leads: Samples
    recent: Samples
    recent_at: Times
    steps: Samples
    moves: Samples
    travels: Samples
    kinds: Times
    counted: Times
    spans: Times
    books: Times
    values: Samples
    events: Times
    ratings: Samples


class Remembered:
    """`Memory` as a state: a slotted dataclass of the same arrays by the same names, without the tables that are no part of it."""

    __slots__ = ()
    known: Times
    books: Times

    def with_room(self, rows: int) -> Memory:
        """The arrays, and a table with room for `rows` events."""
        kept = [getattr(self, name) for name in REMEMBERED]
        return Memory(*kept, *[np.empty((rows, EVENT_WIDTH), np.int64), np.empty(rows)])

    def told(self, memory: Memory) -> tuple[Times, Samples]:
        """The events that the last call wrote, and their ratings."""
        made = int(self.books[EVENTS])
        return memory.events[:made], memory.ratings[:made]


REMEMBERED = [name for name in Memory._fields if name not in ("events", "ratings")]
_MemoryState = make_dataclass("_MemoryState", [(name, Array) for name in REMEMBERED], bases=(Remembered,), slots=True)


def allocate(
    width: int, frames: dict[str, int], radius: float | None, factor: float, firsts: Times | None = None
) -> Remembered:
    """Nothing seen yet. `frames`: the numbers LAG to REST, by name. `firsts`: where frames have a mirror image."""
    lag = frames["LAG"]
    ring = max(frames["WINDOW"], 5 * lag + frames["FIRM"] + 64)
    rows = 3 * lag + frames["FIRM"] + 64
    books = np.zeros(len(NAMES), np.int64)
    for name, value in frames.items():
        books[NAMES.index(name)] = value
    books[FIXED] = radius is not None
    books[BAND] = frames["BAND_MOST"]
    books[[BEST_START, BEST_END]] = -1
    books[PATCHY] = NEVER_KNOWN
    clusters = np.zeros((MOST_CLUSTERS, 5), np.int64)
    clusters[:, NUMBER] = -1
    index = index_of(width, RING * lag, 0)
    values = np.zeros(EARLY_RADIUS + 1)
    values[[BEST, PRICE]] = np.inf
    values[[FACTOR, STILL_SHARE, TRAVEL_SHARE]] = factor, STILL, TRAVELS
    values[RADIUS] = 0.0 if radius is None else radius
    made: Remembered = _MemoryState(
        frames=np.zeros((width, 2 * ring)),
        known=np.full(width, NEVER_KNOWN),
        common=np.zeros(lag + 1),
        times=np.zeros(ring, np.int64),
        rows=np.full((rows, lag + 1), np.inf),
        near=np.zeros(rows, np.int8),
        sums=np.zeros((rows, lag + 1)),
        cost=np.full((2, lag + 1), np.inf),
        begin=np.full((2, lag + 1), -1, np.int64),
        scratch=np.zeros(lag + 1),
        exemplars=np.zeros((width, RING * lag)),
        owners=np.zeros(RING * lag, np.int64),
        lookup=index.floats,
        lookup_books=index.books,
        clusters=clusters,
        mirrored=np.full((0 if firsts is None else ring, width), np.nan),
        firsts=np.zeros(width, np.int64) if firsts is None else firsts,
        leads=np.zeros(MOST_CLUSTERS),
        recent=np.full((frames["REST"], width), np.nan),
        recent_at=np.zeros(frames["REST"], np.int64),
        steps=np.full(frames["REST"], np.nan),
        moves=np.zeros(ring),
        travels=np.zeros(MOST_CLUSTERS),
        kinds=np.zeros(4, np.int64),
        counted=np.zeros(8, np.int64),
        spans=np.full((64, 4), -1, np.int64),
        books=books,
        values=values,
    )
    return made
