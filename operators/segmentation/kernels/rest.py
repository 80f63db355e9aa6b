"""Rest: frames in which nothing has moved for a while, of all that has moved lately, are left out of everything and told apart; and
those in which nothing is seen for a while, of which there are no events."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.events import tell
from kinegraph.operators.segmentation.kernels.layout import (
    BEST_END,
    EVERY,
    MASS,
    MODE,
    MOVED,
    NEXT,
    NOISE,
    OPEN,
    PEAK,
    PEAK_AT,
    PENDING,
    RECENT,
    REST,
    REST_EVENT,
    REST_FROM,
    REST_TO,
    RESTED,
    RESTING_EVENT,
    RESUMED,
    SINCE,
    STILL_SHARE,
    STOOD,
    TO,
    TRACK,
    TRANSITION,
    UNSEEN,
    WINDOW,
    Memory,
)
from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def rests(s: Memory, x: Samples, stamp: int) -> bool:
    """Whether frame `x` (features,) belongs to a rest: so it is not worked through. A rest that it ends is reported.

    Frames of the rest that were worked through, before it was known to be one, have a negative number in `moves` from then on. It begins
    with the first of them that lies behind the last rest, and behind the repetition that ended with it.
    """
    b = s.books
    s.values[MOVED] = moved(s, x)
    b[RECENT] += 1
    place = b[RECENT] % s.recent.shape[0]
    oldest = s.recent_at[place]
    s.recent[place], s.recent_at[place] = x, stamp
    if b[RECENT] <= b[REST] or s.values[MOVED] >= s.values[STILL_SHARE] * s.values[PEAK]:
        tell_rest(s)
        return False
    if not b[RESTED]:
        b[REST_FROM] = stamp
        i, ended = b[NEXT] - 1, last_repeated(s)
        while i > ended and s.times[i % s.times.shape[0]] >= oldest:
            s.moves[i % s.moves.shape[0]] = -abs(s.moves[i % s.moves.shape[0]])
            if not b[STOOD] or s.times[i % s.times.shape[0]] > b[REST_TO]:
                b[REST_FROM] = s.times[i % s.times.shape[0]]
            i -= 1
        b[STOOD] = 1
        tell(s, RESTING_EVENT, b[REST_FROM], 0, 0, 0, 0, 0)
    b[RESTED] += 1
    b[REST_TO] = stamp
    return True


@kernel
def last_repeated(s: Memory) -> int:
    """The last frame of the newest repetition of the open activity that is not final; the one before all frames, if there is none."""
    b, last = s.books, s.books[SINCE] - 1
    if b[OPEN] and b[PENDING]:
        last = max(last, b[TO])
    if b[OPEN] and b[MODE] == TRACK:
        last = max(last, b[BEST_END])
    return int(last)


@kernel
def unseen(s: Memory, x: Samples) -> bool:
    """Whether nothing of frame `x` (features,) is known, nor was of the REST frames before it, or ever: so it is not worked through."""
    b = s.books
    for d in range(x.shape[0]):
        if math.isfinite(x[d]):
            if b[UNSEEN] > b[REST] + b[TRANSITION]:
                b[RESUMED] = b[NEXT]
            b[UNSEEN] = 0
            return False
    b[UNSEEN] += 1
    return bool(b[NEXT] == b[SINCE] or b[UNSEEN] > b[REST])


@kernel
def tell_rest(s: Memory) -> None:
    """A rest, if there was one, is over."""
    b = s.books
    if b[RESTED]:
        tell(s, REST_EVENT, b[REST_FROM], b[REST_TO], 0, 0, 0, 0)
        if b[RESTED] > b[TRANSITION]:
            b[RESUMED] = b[NEXT]
        b[RESTED] = 0


@kernel
def moved(s: Memory, x: Samples) -> float:
    """Mean distance of frame `x` to those of the last REST frames, rests included, less what they differ by from one to the next: that is
    noise, and no motion where it adds up to nothing (asked from half of REST on). Where less than half of them are known, as of the one
    before."""
    b = s.books
    if not b[RECENT]:
        return 0.0
    total, count, steps, pairs = 0.0, 0, 0.0, 0
    frames, ring = min(b[REST], b[RECENT]), s.recent.shape[0]
    s.steps[(b[RECENT] + 1) % ring] = mean_square(x, s.recent[b[RECENT] % ring])
    for k in range(frames):
        apart, step = mean_square(x, s.recent[(b[RECENT] - k) % ring]), s.steps[(b[RECENT] + 1 - k) % ring]
        if apart == apart:
            total += math.sqrt(apart)
            count += 1
        if step == step:
            steps += step
            pairs += 1
    if not count or 2 * count < frames:
        before: float = s.values[MOVED]
        return before
    mean, noise = total / count, NOISE * steps / pairs if pairs and 2 * frames >= b[REST] else 0.0
    least = s.values[STILL_SHARE] * s.values[STILL_SHARE] * noise
    return math.sqrt(max(least, mean * mean - noise))


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
    """How much the liveliest frames of the window move: those worth MASS do no less."""
    b = s.books
    if t < b[PEAK_AT]:
        return
    b[PEAK_AT] = t + b[EVERY]
    first = max(b[SINCE], t - b[WINDOW] + 1)
    n = t - first + 1
    if n < b[MASS]:
        s.values[PEAK] = 0.0
        return
    found = np.empty(n)
    for i in range(n):
        found[i] = abs(s.moves[(first + i) % s.moves.shape[0]])
    found.sort()
    s.values[PEAK] = found[n - b[MASS]]
    if not b[STOOD]:
        tell_first_rest(s, first, t)


@kernel
def tell_first_rest(s: Memory, first: int, t: int) -> None:
    """Who stood still before anything moved rested, which can only be known now, by what the motion is like.

    It must have gone on for MASS at the least, and at the most until MASS frames of it have been looked at that no rest is averaged into.
    Stillness that does not reach back to the first frame is judged then: by the motion's first frames alone, which move little, noise may
    look like motion.
    """
    b, begins = s.books, t + 1
    while begins > first and not at_rest(s, begins - 1):
        begins -= 1
    onset = begins
    while onset > first and at_rest(s, onset - 1):
        onset -= 1
    least = b[MASS] if onset == first else b[REST] + b[MASS] + b[EVERY]
    if begins - onset > b[REST] and least <= t + 1 - begins <= b[REST] + b[MASS] + 2 * b[EVERY]:
        b[STOOD] = 1
        for i in range(onset, begins):
            s.moves[i % s.moves.shape[0]] = -abs(s.moves[i % s.moves.shape[0]])
        tell(s, REST_EVENT, s.times[onset % s.times.shape[0]], s.times[(begins - 1) % s.times.shape[0]], 0, 0, 0, 0)


@kernel
def at_rest(s: Memory, i: int) -> bool:
    """Whether frame `i`, which was worked through, would be left out by what is known of the motion now."""
    return bool(abs(s.moves[i % s.moves.shape[0]]) < s.values[STILL_SHARE] * s.values[PEAK])


@kernel
def reported_at_rest(s: Memory, i: int) -> bool:
    """Whether frame `i`, which was worked through, lies in a rest that was reported: it began before it was noticed."""
    return bool(s.moves[i % s.moves.shape[0]] < 0.0)
