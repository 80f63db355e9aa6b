"""The motion map: each pose's place on a picture of all poses so far, which never flips or jumps (thesis, chapter 5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.features.eigen import eigen_part, symmetric_eigen
from kinegraph.operators.inputs.channels import names_of
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, samples_in, width_of
from kinegraph.stream.errors import InputError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Emitted, Operator, grid
from kinegraph.stream.params import param

WIDEST = 150
"""The eigenvectors of a wider covariance take longer than a frame."""
SPREAD = 2
"""A plane is found over this part of the time until the next, so that no frame takes much longer than others."""
NOWHERE = 1e-9
"""A cosine below this says no direction."""


class MapNumbers:
    min_share: float
    every: int
    max_rad: float
    frames: int
    part: int


@record
@dataclass(slots=True)
class MotionMapState(MapNumbers):
    """
    used          (c,)     which of the input's numbers count
    min_share              the least that a frame counts in mean and covariance
    every                  frames after which the plane is learned again
    max_rad                the most that axes turn from one frame to the next
    frames                 how many frames were learned
    mean, centre  (c,)     of all frames; of the picture
    covariance    (c, c)
    axes, target  (k, c)   the picture's axes; the principal axes, which they turn to
    part                   how far the next target is found, of 3 c parts; room (c, c), lines (2, c), vectors (c, c): what is found of it
    frame, pairs, small    room, which remembers nothing
    """

    numbers: Array
    used: Times
    mean: Samples
    centre: Samples
    covariance: Samples
    axes: Samples
    target: Samples
    room: Samples
    lines: Samples
    vectors: Samples
    frame: Samples
    pairs: Samples
    small: Samples


NUMBERS = numbers_of(MapNumbers)


@kernel
def dot(a: Samples, b: Samples) -> float:
    total = 0.0
    for c in range(a.shape[0]):
        total += a[c] * b[c]
    return total


@kernel
def take_away(v: Samples, others: Samples, count: int) -> float:
    """Take from `v` its part along the first `count` unit rows of `others`, and make it a unit; returns what length was left."""
    for _ in range(2):
        for j in range(count):
            along = dot(v, others[j])
            for c in range(v.shape[0]):
                v[c] -= along * others[j, c]
    length = math.sqrt(dot(v, v))
    if length > 0.0:
        v /= length
    return length


@kernel
def learn(s: MotionMapState) -> None:
    """Take a frame into mean and covariance: all frames count the same, until a new one would count less than `min_share`."""
    x, mean, covariance = s.frame, s.mean, s.covariance
    s.frames += 1
    share = max(1.0 / s.frames, s.min_share)
    for c in range(x.shape[0]):
        mean[c] += share * (x[c] - mean[c])
    if share == 1.0:
        return
    for c in range(x.shape[0]):
        for d in range(x.shape[0]):
            # x - mean, after the step, is (1 - share) times what it was before
            product = (x[c] - mean[c]) * (x[d] - mean[d]) / ((1.0 - share) * (1.0 - share))
            covariance[c, d] = (1.0 - share) * (covariance[c, d] + share * product)


@kernel
def principal(values: Samples, vectors: Samples, out: Samples) -> None:
    """The k principal axes into rows of `out` (k, c), the greatest first; the greatest number of each is positive. Uses up `values`."""
    width = values.shape[0]
    for k in range(out.shape[0]):
        best = 0
        for c in range(width):
            if values[c] > values[best]:
                best = c
        values[best] = -math.inf
        top = 0
        for c in range(width):
            if abs(vectors[best, c]) > abs(vectors[best, top]):
                top = c
        for c in range(width):
            out[k, c] = math.copysign(1.0, vectors[best, top]) * vectors[best, c]


@kernel
def look_for_plane(s: MotionMapState) -> None:
    """One frame's share of finding the plane that the covariance had at the last multiple of `every`; the first plane is found at once."""
    width = s.covariance.shape[0]
    if s.frames % s.every == 0:
        s.room[:] = s.covariance
        s.part = 0
    if s.part == 3 * width:
        return
    share = 3 * width if s.frames == s.every else -(-3 * width // max(1, s.every // SPREAD))
    upto = min(3 * width, s.part + share)
    for k in range(s.part, upto):
        eigen_part(k, s.room, width, s.lines[0], s.lines[1], s.vectors)
    s.part = upto
    if upto == 3 * width:
        principal(s.lines[0], s.vectors, s.target)


@kernel
def turn(axes: Samples, target: Samples, max_rad: float, pairs: Samples, small: Samples) -> None:
    """Turn `axes` (k, c) towards the plane of `target` (k, c), along the shortest way, no axis by more than `max_rad`.

    Arrived, they are the axes of that plane nearest to those before: what the orthogonal Procrustes problem gives.

    pairs  (3, k, c)     room for the principal vectors of both planes, and where a vector lies in the target's
    small  (3, k, k + 2) room
    """
    count, width = axes.shape
    gram, values, rest, vectors = small[0], small[1, 0], small[1, 1], small[2]
    ours, ways, there = pairs[0], pairs[1], pairs[2]
    for i in range(count):
        for j in range(count):
            gram[i, j] = 0.0
            for t in range(count):
                gram[i, j] += dot(axes[i], target[t]) * dot(axes[j], target[t])
    symmetric_eigen(gram, count, values, rest, vectors)
    for i in range(count):  # by falling cosine, so that what has no direction yet comes last
        for j in range(i + 1, count):
            if values[j] > values[i]:
                values[i], values[j] = values[j], values[i]
                for t in range(count):
                    vectors[i, t], vectors[j, t] = vectors[j, t], vectors[i, t]
    widest = 0.0
    for i in range(count):
        for c in range(width):
            ours[i, c] = 0.0
            there[i, c] = 0.0
            for j in range(count):
                ours[i, c] += vectors[i, j] * axes[j, c]
        for t in range(count):
            along = dot(ours[i], target[t])
            for c in range(width):
                there[i, c] += along * target[t, c]
        cosine = take_away(there[i], there, i)
        if cosine < NOWHERE:
            aim(there, i, target, ways[i])
            cosine = 0.0
        for c in range(width):
            ways[i, c] = there[i, c] - dot(there[i], ours[i]) * ours[i, c]
        sine = take_away(ways[i], ours, i + 1)
        rest[i] = math.atan2(sine, cosine)
        widest = max(widest, rest[i])
    share = 1.0 if widest <= max_rad else max_rad / widest
    for i in range(count):
        c_i, s_i = math.cos(share * rest[i]), math.sin(share * rest[i])
        for c in range(width):
            ours[i, c] = c_i * ours[i, c] + s_i * ways[i, c]
    for j in range(count):
        for c in range(width):
            axes[j, c] = 0.0
            for i in range(count):
                axes[j, c] += vectors[i, j] * ours[i, c]
        take_away(axes[j], axes, j)


@kernel
def aim(there: Samples, i: int, target: Samples, trial: Samples) -> None:
    """A unit vector of the target's plane that the first i of `there` do not cover, into `there[i]`: of several, the clearest."""
    longest = -1.0
    for t in range(target.shape[0]):
        trial[:] = target[t]
        length = take_away(trial, there, i)
        if length > longest:
            longest = length
            there[i] = trial


@kernel
def follow(centre: Samples, mean: Samples, most: float) -> None:
    """Move the picture's centre towards the mean by `most` at the most."""
    total = 0.0
    for c in range(mean.shape[0]):
        total += (mean[c] - centre[c]) ** 2
    share = 1.0 if total <= most * most else most / math.sqrt(total)
    for c in range(mean.shape[0]):
        centre[c] += share * (mean[c] - centre[c])


@kernel
def place(s: MotionMapState, x: Samples, out: Samples, explained: Samples) -> None:
    """Places of the poses `x` (n, width) into `out` (n, k), each axis's share of the variance so far into `explained` (n, k)."""
    frame, mean, centre, covariance, axes = s.frame, s.mean, s.centre, s.covariance, s.axes
    for i in range(x.shape[0]):
        whole = True
        for c in range(s.used.shape[0]):
            frame[c] = finite(x[i, s.used[c]])
            whole = whole and frame[c] == frame[c]
        if whole:
            learn(s)
            if s.frames >= s.every:
                look_for_plane(s)
            if s.frames == s.every:
                axes[:] = s.target
                centre[:] = mean
        total = 0.0
        for c in range(mean.shape[0]):
            total += covariance[c, c]
        learned = s.frames >= s.every
        if whole and s.frames > s.every:
            turn(axes, s.target, s.max_rad, s.pairs, s.small)
            follow(centre, mean, s.max_rad * math.sqrt(total))
        for k in range(axes.shape[0]):
            out[i, k] = math.nan
            explained[i, k] = math.nan
            if learned and whole:
                out[i, k] = 0.0
                for c in range(mean.shape[0]):
                    out[i, k] += axes[k, c] * (frame[c] - centre[c])
            if learned and total > 0.0:
                held = 0.0
                for c in range(mean.shape[0]):
                    held += axes[k, c] * dot(covariance[c], axes[k])
                explained[i, k] = held / total


@dataclass(frozen=True, slots=True)
class MotionMap(Operator[MotionMapState]):
    """Poses or other features (width,) in; out comes each one's place on the PCA of those so far. It learns from the first frame on.

    map        (axes,)  the place, in the input's unit. NaN during the first `learn_s`, and where a feature is
    explained  (axes,)  which share of the variance so far lies along each axis that is shown; together: along the picture

    Every `learn_s` the principal plane (with `axes: 3` the space) of the covariance is recomputed, over the half of that time that
    follows, so that no frame takes much longer than others. The picture's axes turn to it along the shortest way, and stay as near to
    what they were as that plane allows (the orthogonal Procrustes problem): no sign flips, no axes change places. No axis turns faster
    than `rotation_deg_per_s`, and the picture's centre follows the mean no faster than a pose at the poses' rms distance from it would
    move by that. So the axes span the principal plane, but need not be the principal axes.

    Time is counted in frames: nothing turns in a gap, or while frames are bad. Channels in the input's `meta["missing"]`
    (operators.features.normalised_pose.NormalisedPose) are left out. The memory is a covariance, however long the session is. No delay.

    Source: thesis, 5.3.3 (PCA of normalised poses). Departure: it learns live, where the thesis has the whole recording.

    >>> given, made = tried(MotionMap)
    >>> given["in"][-1].round(1), made["map"][-1].round(1)
    (array([ -0.6,  -1. , -12. ,  -5.4,   0. ]), array([-1.4,  6.2]))
    """

    outputs: ClassVar[tuple[str, ...]] = ("map", "explained")

    axes: int = param(2, least=1, most=3, help="how many axes the picture has")
    rotation_deg_per_s: float = param(20.0, above=0.0, help="the fastest that an axis turns")
    learn_s: float = param(1.0, above=0.0, help="how often the plane is learned again")
    memory_s: float = param(0.0, least=0.0, help="older frames are forgotten over this long; 0: never")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_signal or len(set(spec.units)) != 1:
            raise InputError("in", spec.describe(), "a signal of features in one unit")
        rate_hz = regular(spec)
        missing = set(spec.meta.get("missing", ()))
        names = names_of(spec)
        used = np.array([c for c in range(width_of(spec)) if names[c] not in missing], np.int64)
        c, k = len(used), self.axes
        if not k <= c <= WIDEST:
            raise InputError(
                "in",
                spec.describe(),
                f"{k} to {WIDEST} features (operators.filters.channels.Select takes some of them)",
            )
        state = MotionMapState(
            numbers=np.zeros((), NUMBERS),
            used=used,
            mean=np.zeros(c),
            centre=np.zeros(c),
            covariance=np.zeros((c, c)),
            axes=np.zeros((k, c)),
            target=np.zeros((k, c)),
            frame=np.zeros(c),
            room=np.zeros((c, c)),
            lines=np.zeros((2, c)),
            vectors=np.zeros((c, c)),
            pairs=np.zeros((3, k, c)),
            small=np.zeros((3, k + 2, k + 2)),
        )
        state.min_share = 1.0 / (1 + samples_in("memory_s", self.memory_s, rate_hz)) if self.memory_s else 0.0
        state.every = max(2, samples_in("learn_s", self.learn_s, rate_hz))
        state.max_rad = float(np.radians(self.rotation_deg_per_s)) / rate_hz
        state.part = 3 * c
        self.set_state(state)
        made = spec.derive(
            shape=(k,),
            dtype=np.dtype(np.float64),
            channels=("x", "y", "z")[:k],
            units=spec.units[:1],
            settling_s=spec.settling_s + self.learn_s,
        )
        return {"map": made, "explained": made.derive(units=("",))}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        s, n = self.state, len(chunk.time)
        out, explained = np.empty((n, self.axes)), np.empty((n, self.axes))
        if n:
            x = np.ascontiguousarray(chunk.data, np.float64)
            place(s, x, out, explained)
        return [
            ("map", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("explained", Chunk(chunk.time, explained, chunk.until, chunk.lost)),
        ]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(54)
        data = np.concatenate([rng.normal(size=(150, 5)) * scale for scale in ((5, 2, 1, 0.5, 0.1), (1, 1, 9, 7, 0.1))])
        spec = StreamSpec((5,), rate_hz=50.0, channels=tuple("abcde"), units=("cm",), meta={"missing": ["e"]})
        inputs = {"in": (spec, grid(50.0, 300), data)}
        return [
            Case(cls(), inputs, least=600),
            Case(cls(axes=3, learn_s=0.2, memory_s=2.0, rotation_deg_per_s=200.0), inputs, least=600),
        ]
