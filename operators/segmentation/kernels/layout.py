"""What a segmentation remembers: one record of arrays and numbers, so that kernels take one argument."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from operator import attrgetter

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import numbers_of, record


class Numbers:
    """The numbers of a segmentation: attributes of `Memory` in kernels and from Python. Frames go by their number; _at, _to: stamps, in ns.

    Where nothing else is stated, a number counts frames.
    """

    max_lag: int  # longest cycle, and how far back neighbours are looked for
    window: int  # frames that the radius is taken from
    learn: int  # how many of them there must be
    quiet: int  # so many without a neighbour end an activity
    mass: int  # so many with one open it
    settle: int  # how long after its opening an activity's start is sought
    firm: int  # how long after its opening its start is decided at the latest
    min_band: int  # bounds of the band around the diagonal
    max_band: int
    every: int  # between two choices of the radius while nothing is open
    rest: int  # so many in which nothing moves are a rest
    transition: int  # between two activities, at the most, that are divided between them
    is_radius_fixed: bool  # whether the radius is given
    period_ns: int  # nominal time from one frame to the next

    next_frame: int  # number of the next frame
    since: int  # the first frame since the start or a gap
    now: int  # the stamp of what is decided now
    event_count: int  # rows written to the table of events
    present: int  # features that have been known within the newest window
    patchy: int  # the last frame in which a feature was not known

    radius: float
    radius_share: float  # the radius as a share of the median distance
    early_radius: float  # the radius before `learn`
    radius_due: int  # when the radius is chosen next
    band: int  # frames less far away are no neighbours
    near_count: int  # of the newest `max_lag` frames, how many have a neighbour
    seed: int  # first frame after the last activity: neighbours are not looked for before it
    unreported: int  # first frame that is part of no reported activity
    unreported_at: int

    activity: int  # number of the next activity
    is_open: bool  # whether an activity is open
    opened: int  # since when
    last: int  # the last frame with a neighbour
    noticed: int  # the first frame that had come back when the open activity was noticed
    is_begun: bool  # whether its start has been sought
    is_start_final: bool  # whether its start is decided and reported
    start: int
    start_at: int
    has_returned: bool  # whether it has been seen to come back to itself after it had left
    repeated_until: int  # until then activities count that do not come back: a window after the last repetition

    is_tracking: bool  # whether the open activity's cycle is known and followed; else it is searched for
    origin: int  # where the search for a cycle begins
    done: int  # the last frame worked through
    slot: int  # which exemplar is followed
    length: int  # its length
    free: int  # no path starts before this frame
    best: float  # the mean distance of the best path not yet accepted
    best_start: int  # its first and last frame; -1: there is no such path
    best_end: int

    count: int  # repetitions of the open activity that are accepted
    is_pending: bool  # whether a repetition waits for its end
    pending_from: int  # its path
    pending_to: int
    price: float  # its mean distance
    cycles: int  # repetitions of the open activity that are reported
    prices: float  # how far they lie from their exemplars, added up
    outings: int  # excursions of the open activity that are reported as repetitions beside its cycles
    pieces_from: int  # first frame of the activity that is not yet reported as a primitive
    pieces_at: int
    reported_to: int  # stamp of the frame before that
    like_count: int  # repetitions reported since the exemplar was taken up
    farthest: float  # how far they lie from it at the most

    is_paused: bool  # whether longer rests lie between its repetitions
    bout: int  # bouts of the open activity that are reported
    bout_count: int  # repetitions in the one under way
    bout_at: int  # stamps of its first repetition's onset and of its last one's end
    bout_to: int

    cluster: int  # of the pending repetition
    next_cluster: int  # number of the next new one
    clock: int  # counts uses of exemplars
    turn: int  # the exemplar that is compared next
    travel_share: float  # see TRAVELS

    is_held: bool  # whether an activity has ended and its end is decided with the next one's start
    held_first: int  # its first and last frame, as far as it is known, and their stamps
    held_last: int
    held_at: int
    held_to: int
    held_cycles: int  # its repetitions
    held_cluster: int
    held_how: int  # the last number of its event
    held_certainty: float
    held_radius: float

    believed: int  # the count reported last
    believed_of: int  # and of which activity
    is_grown: bool  # whether repetitions are believed that begin where the open activity was grown back to
    foreseen: int  # the last frame of the newest repetition that is believed before its activity has a cycle
    ahead: int  # repetitions believed of the activity after the open one
    back: int  # excursions that are believed, of what nothing final covers
    back_from: int  # the newest one's first and last frame
    back_to: int

    recent_count: int  # frames seen since the start or a gap, those at rest included
    moved: float  # how much the newest frame moves
    peak: float  # how much the window's liveliest frames move
    peak_due: int  # when that is judged again
    rested: int  # frames left out by the rest under way; 0: there is none
    rest_from: int  # stamps of its first and newest frame
    rest_to: int
    is_parked: bool  # whether it is an activity of its own
    parked_at: int  # from when on
    has_rested: bool  # whether a rest has been reported since the start or a gap
    resumed: int  # the first frame after the last longer rest, or after nothing was known for longer
    calmest: float  # how far the frames of the calmest `rest` so far lie apart, the sensor's noise included
    unseen: int  # in a row, up to the newest, of which nothing was known


NUMBERS = numbers_of(Numbers)

CALM, LEAST, STILL = 3.0, 0.02, 0.12
"""Who moves less than CALM times what the calmest second so far did, is at rest: by more than the sensor's noise and a body's sway. It is
at least LEAST and at most STILL times what the window's liveliest frames do."""
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

MAX_CLUSTERS = 32
"""The most exemplars that are kept."""

NEVER_KNOWN = -(1 << 60)


@dataclass
class Remembered(Numbers):
    """The arrays that are remembered from one call to the next.

    numbers    ()                  see `Numbers`
    frames     (features, 2 ring)  frames by number modulo ring, twice, so that any `ring` in a row are side by side; NaN: not known
    known      (features,)         the last frame in which each feature was known
    common     (max_lag + 1,)      how many features both frames of a distance have
    times      (ring,)             their stamps
    rows       (rows, max_lag + 1) distance of a frame to the one 1, 2, ... max_lag before it, by number modulo `rows`
    near       (rows,)             whether a frame has a neighbour;  2: it was bad, and never has
    sums       (rows, max_lag + 1) of a frame's distances at each lag and all before it since `origin`
    cost       (2, max_lag + 1)    of the best path that ends at each column of the exemplar, of the frame before and of this one
    begin      (2, max_lag + 1)    the frame where that path starts
    scratch    (max_lag + 1,)      distances of a frame to the exemplar's
    exemplars  (slots, features, max_lag)  frames of exemplars
    cluster_numbers  (slots,)      by slot: the cluster's number; -1: free
    exemplar_sizes, exemplar_uses  (slots,)  its exemplar's length and last use
    mirrored   (ring, features)    mirror images of frames, by number modulo ring; NaN: not known. (0, features) where there are no images
    firsts     (features,)         1: the first of a pair that changes places in the mirror
    leads      (slots,)            how much more the firsts have moved in the first steps of a cluster's cycles than in the second ones
    recent     (rest, features)    the newest frames as they came, by `recent_count` modulo `rest`, and their stamps recent_at (rest,)
    steps      (rest,)             mean square of how much each of them differs from the one before it; NaN: nothing is known of both
    moves      (ring,)             how much each frame moves: see `moved` in rest.py; negative: in a rest that was reported
    travels    (slots,)            how far the exemplars move, from stride to stride
    kinds      (4,)                repetitions of the open activity by their symmetry
    counted    (8,)                the count reported last, by activity modulo 8, until that is final
    spans      (64, 4)             what was reported last of a repetition: activity, number, onset and end
    """

    numbers: Array
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
    cluster_numbers: Times
    exemplar_sizes: Times
    exemplar_uses: Times
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

    def with_room(self, rows: int) -> Memory:
        """The arrays, and a table with room for `rows` events."""
        events: Array = np.empty((rows, EVENT_WIDTH), np.int64)
        return Memory(*(*_ARRAYS(self), events, np.empty(rows)))


_ARRAYS = attrgetter(*(field.name for field in fields(Remembered)))


@record
@dataclass
class Memory(Remembered):
    """What kernels work on: what is remembered, and what a call leads to.

    events     (m, EVENT_WIDTH)    rows; ratings (m,): of a radius its value, of all else how certain the open activity's repetitions are
    """

    events: Times
    ratings: Samples

    def reported(self) -> tuple[Times, Samples]:
        """The events that the last call wrote, and their ratings."""
        return self.events[: self.event_count], self.ratings[: self.event_count]


def allocate(
    width: int, frames: dict[str, int], radius: float | None, radius_share: float, firsts: Times | None = None
) -> Remembered:
    """Nothing seen yet. `frames`: the numbers `max_lag` to `period_ns`, by name. `firsts`: where frames have a mirror image."""
    lag = frames["max_lag"]
    ring = max(frames["window"], 5 * lag + frames["firm"] + 64)
    rows = 3 * lag + frames["firm"] + 64
    made = Remembered(
        numbers=np.zeros((), NUMBERS),
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
        exemplars=np.zeros((MAX_CLUSTERS, width, lag)),
        cluster_numbers=np.full(MAX_CLUSTERS, -1, np.int64),
        exemplar_sizes=np.zeros(MAX_CLUSTERS, np.int64),
        exemplar_uses=np.zeros(MAX_CLUSTERS, np.int64),
        mirrored=np.full((0 if firsts is None else ring, width), np.nan),
        firsts=np.zeros(width, np.int64) if firsts is None else firsts,
        leads=np.zeros(MAX_CLUSTERS),
        recent=np.full((frames["rest"], width), np.nan),
        recent_at=np.zeros(frames["rest"], np.int64),
        steps=np.full(frames["rest"], np.nan),
        moves=np.zeros(ring),
        travels=np.zeros(MAX_CLUSTERS),
        kinds=np.zeros(4, np.int64),
        counted=np.zeros(8, np.int64),
        spans=np.full((64, 4), -1, np.int64),
    )
    for name, value in frames.items():
        setattr(made, name, value)
    made.is_radius_fixed, made.radius, made.radius_share = radius is not None, radius or 0.0, radius_share
    made.band, made.patchy = frames["max_band"], NEVER_KNOWN
    made.best_start = made.best_end = -1
    made.best = made.price = math.inf
    made.travel_share, made.calmest = TRAVELS, math.inf
    return made
