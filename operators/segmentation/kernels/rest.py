"""Rest: frames in which nothing has moved for a while, of all that has moved lately, are left out of everything and told apart; and
those in which nothing is seen for a while, of which there are no events."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.corrections import settle_count
from kinegraph.operators.segmentation.kernels.events import tell
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY_EVENT,
    CALM,
    LEAST,
    NOISE,
    PRIMITIVE_EVENT,
    REST_EVENT,
    RESTING_EVENT,
    STILL,
    Memory,
)
from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.ordering import select
from kinegraph.stream.kernel import kernel

NOTHING = 1e-24
"""Nothing moves less: how much a frame moves has a sign, which says whether it lies in a rest."""


@kernel
def rests(s: Memory, x: Samples, stamp: int) -> bool:
    """Whether frame `x` (features,) belongs to a rest: so it is not worked through. A rest that it ends is reported.

    Frames of the rest that were worked through, before it was known to be one, have a negative number in `moves` from then on. It begins
    with the first of them that lies behind the last rest, and behind the repetition that ended with it.
    """
    s.moved = moved(s, x)
    s.recent_count += 1
    place = s.recent_count % s.recent.shape[0]
    oldest = s.recent_at[place]
    s.recent_at[place] = stamp
    for d in range(x.shape[0]):
        s.recent[place, d] = x[d]
    if s.recent_count <= s.rest or s.moved >= calm(s):
        tell_rest(s, False)
        return False
    if not s.rested:
        s.rest_from = stamp
        i, ended = s.next_frame - 1, last_repeated(s)
        while i > ended and s.times[i % s.times.shape[0]] >= oldest:
            s.moves[i % s.moves.shape[0]] = -abs(s.moves[i % s.moves.shape[0]])
            if not s.has_rested or s.times[i % s.times.shape[0]] > s.rest_to:
                s.rest_from = s.times[i % s.times.shape[0]]
            i -= 1
        s.has_rested = True
        tell(s, RESTING_EVENT, s.rest_from, 0, 0, 0, 0, 0)
    s.rested += 1
    s.rest_to = stamp
    return True


@kernel
def calm(s: Memory) -> float:
    """Who moves less than this is at rest."""
    return float(min(STILL * s.peak, max(LEAST * s.peak, CALM * s.calmest)))


@kernel
def last_repeated(s: Memory) -> int:
    """The last frame of the newest repetition of the open activity that is not final; the one before all frames, if there is none."""
    last = s.since - 1
    if s.is_open and s.is_pending:
        last = max(last, s.pending_to)
    if s.is_open and s.is_tracking:
        last = max(last, s.best_end)
    return int(last)


@kernel
def unseen(s: Memory, x: Samples) -> bool:
    """Whether nothing of frame `x` (features,) is known, nor was of the `rest` frames before it, or ever: so it is not worked through."""
    for d in range(x.shape[0]):
        if math.isfinite(x[d]):
            if s.unseen > s.rest + s.transition:
                s.resumed = s.next_frame
            s.unseen = 0
            return False
    s.unseen += 1
    return bool(s.next_frame == s.since or s.unseen > s.rest)


@kernel
def tell_rest(s: Memory, forced: bool) -> None:
    """A rest, if there was one, is over."""
    if not s.rested:
        return
    tell(s, REST_EVENT, s.rest_from, s.rest_to, 0, 0, 0, 0)
    if s.rested > s.transition:
        s.resumed = s.next_frame
    s.rested = 0
    if s.is_parked:
        s.is_parked = False
        tell(s, PRIMITIVE_EVENT, s.parked_at, s.rest_to, s.activity, 0, -1, forced)
        settle_count(s, s.activity, 0)
        tell(s, ACTIVITY_EVENT, s.parked_at, s.rest_to, s.activity, 0, -1, forced)
        s.activity += 1


@kernel
def moved(s: Memory, x: Samples) -> float:
    """Mean distance of frame `x` to those of the last `rest` frames, rests included, less what they differ by from one to the next: that is
    noise, and no motion where it adds up to nothing (asked from half of `rest` on). Where less than half of them are known, as of the one
    before."""
    if not s.recent_count:
        return 0.0
    total, count, steps, pairs = 0.0, 0, 0.0, 0
    frames, ring = min(s.rest, s.recent_count), s.recent.shape[0]
    s.steps[(s.recent_count + 1) % ring] = mean_square(x, s.recent[s.recent_count % ring])
    for k in range(frames):
        apart, step = mean_square(x, s.recent[(s.recent_count - k) % ring]), s.steps[(s.recent_count + 1 - k) % ring]
        if apart == apart:
            total += math.sqrt(apart)
            count += 1
        if step == step:
            steps += step
            pairs += 1
    if not count or 2 * count < frames:
        before: float = s.moved
        return before
    mean, noise = total / count, NOISE * steps / pairs if pairs and 2 * frames >= s.rest else 0.0
    if frames >= s.rest and mean > 0.0:
        s.calmest = min(s.calmest, mean)
    return math.sqrt(max(NOTHING, STILL * STILL * noise, mean * mean - noise))


@kernel
def mean_square(x: Samples, y: Samples) -> float:
    """Of the difference of two frames (features,), over what is known of both; NaN where nothing is."""
    total, common = 0.0, 0.0
    for d in range(x.shape[0]):
        apart = x[d] - y[d]
        if math.isfinite(apart):
            total += apart * apart
            common += 1.0
    return total / common if common else math.nan


@kernel
def choose_peak(s: Memory, t: int) -> None:
    """How much the liveliest frames of the window move: those worth `mass` do no less."""
    if t < s.peak_due:
        return
    s.peak_due = t + s.every
    first = max(s.since, t - s.window + 1)
    n = t - first + 1
    if n < s.mass:
        s.peak = 0.0
        return
    found = np.empty(n)
    for i in range(n):
        found[i] = abs(s.moves[(first + i) % s.moves.shape[0]])
    s.peak = select(found, n, n - s.mass)
    if not s.has_rested:
        tell_first_rest(s, first, t)


@kernel
def tell_first_rest(s: Memory, first: int, t: int) -> None:
    """Who stood still before anything moved rested, which can only be known now, by what the motion is like.

    It must have lasted for `mass` at the least, and at the most until `mass` of its frames have been seen without a rest in their mean.
    Stillness that does not reach back to the first frame is judged then: by the motion's first frames alone, which move little, noise may
    look like motion.
    """
    begins = t + 1
    while begins > first and not at_rest(s, begins - 1):
        begins -= 1
    onset = begins
    while onset > first and at_rest(s, onset - 1):
        onset -= 1
    least = s.mass if onset == first else s.rest + s.mass + s.every
    if begins - onset > s.rest and least <= t + 1 - begins <= s.rest + s.mass + 2 * s.every:
        s.has_rested = True
        for i in range(onset, begins):
            s.moves[i % s.moves.shape[0]] = -abs(s.moves[i % s.moves.shape[0]])
        tell(s, REST_EVENT, s.times[onset % s.times.shape[0]], s.times[(begins - 1) % s.times.shape[0]], 0, 0, 0, 0)


@kernel
def at_rest(s: Memory, i: int) -> bool:
    """Whether frame `i`, which was worked through, would be left out by what is known of the motion now."""
    return bool(abs(s.moves[i % s.moves.shape[0]]) < calm(s))


@kernel
def reported_at_rest(s: Memory, i: int) -> bool:
    """Whether frame `i`, which was worked through, lies in a rest that was reported: it began before it was noticed."""
    return bool(s.moves[i % s.moves.shape[0]] < 0.0)
