"""Bivariate Gaussian mixtures of activation peaks: a start by k-means along the cycle, and EM (thesis 6.2.4).

A peak is a point (place, height): the place in % of the cycle, 0 <= place < 100, the height in the curve's unit. Along the cycle a burst at
touch-down is one mode, so the density is that of a normal distribution wrapped around the cycle: the sum over `turns` turns to either side.
With turns = 0 it is the plain Gaussian mixture of the thesis, where eq. 6.5 misprints exponent and normaliser.

A mixture of k modes is three arrays: weights (k,), means (k, 2), covariances (k, 3) as (variance of place, covariance, variance of height).
"""

from __future__ import annotations

from math import exp, floor, inf, log, pi

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

CYCLE = 100.0
NOTHING = -200.0
"""Shares of exp(-200) or less count as zero."""


@kernel
def wrapped(place: float) -> float:
    """A place on the cycle, 0 <= place < 100."""
    within = place - CYCLE * floor(place / CYCLE)
    return within if 0.0 <= within < CYCLE else 0.0


@kernel
def sweep(
    points: Samples, weights: Samples, means: Samples, covariances: Samples,
    turns: int, least: Samples, scratch: Samples,
) -> float:  # fmt: skip
    """One expectation and maximisation, of the mixture that is given and into it; returns the mean log-likelihood of a point before it.

    How much each mode and turn accounts for a point is added up at once, as moments about the mode's mean, so no share is kept.

    points   (n, 2)
    least    (2,) is added to the variances of place and height (a mode of equal points)
    scratch  (k, 10 + 2 turns + 1), written over
    """
    n, k, total = points.shape[0], weights.shape[0], 0.0
    for j in range(k):
        a, b, c = covariances[j, 0], covariances[j, 1], covariances[j, 2]
        det = a * c - b * b
        scratch[j, 0] = (log(weights[j]) if weights[j] > 0.0 else -inf) - log(2.0 * pi) - 0.5 * log(det)
        scratch[j, 1], scratch[j, 2], scratch[j, 3] = c / det, b / det, a / det
        scratch[j, 4:10] = 0.0
    for i in range(n):
        place, height, highest = points[i, 0], points[i, 1], -inf
        for j in range(k):
            mean, dy = means[j, 0], height - means[j, 1]
            base, a, b, c = scratch[j, 0], scratch[j, 1], scratch[j, 2], scratch[j, 3]
            for t in range(2 * turns + 1):
                dx = place + CYCLE * (t - turns) - mean
                value = base - 0.5 * (a * dx * dx - 2.0 * b * dx * dy + c * dy * dy)
                scratch[j, 10 + t] = value
                highest = max(highest, value)
        mass = 0.0
        for j in range(k):
            for t in range(2 * turns + 1):
                near = scratch[j, 10 + t] - highest
                scratch[j, 10 + t] = exp(near) if near > NOTHING else 0.0
                mass += scratch[j, 10 + t]
        for j in range(k):
            mean, dy = means[j, 0], height - means[j, 1]
            m, x, y, xx, xy, yy = (
                scratch[j, 4],
                scratch[j, 5],
                scratch[j, 6],
                scratch[j, 7],
                scratch[j, 8],
                scratch[j, 9],
            )
            for t in range(2 * turns + 1):
                if scratch[j, 10 + t] > 0.0:
                    r, dx = scratch[j, 10 + t] / mass, place + CYCLE * (t - turns) - mean
                    m += r
                    x += r * dx
                    y += r * dy
                    xx += r * dx * dx
                    xy += r * dx * dy
                    yy += r * dy * dy
            scratch[j, 4], scratch[j, 5], scratch[j, 6], scratch[j, 7], scratch[j, 8], scratch[j, 9] = (
                m,
                x,
                y,
                xx,
                xy,
                yy,
            )
        total += highest + log(mass)
    maximise(n, weights, means, covariances, turns, least, scratch)
    return float(total / n)


@kernel
def maximise(
    n: int, weights: Samples, means: Samples, covariances: Samples, turns: int, least: Samples, scratch: Samples
) -> None:
    """The mixture that the moments in `scratch[:, 4:10]` make likeliest: mass, place, height, and their products, about the old mean."""
    for j in range(weights.shape[0]):
        mass = scratch[j, 4]
        weights[j] = mass / n
        if mass <= 0.0:
            continue  # a mode that accounts for nothing stays where it is, with no weight
        x, y = scratch[j, 5] / mass, scratch[j, 6] / mass
        covariances[j, 0] = max(scratch[j, 7] / mass - x * x, 0.0) + least[0]
        covariances[j, 1] = scratch[j, 8] / mass - x * y
        covariances[j, 2] = max(scratch[j, 9] / mass - y * y, 0.0) + least[1]
        means[j, 0] = wrapped(means[j, 0] + x) if turns else means[j, 0] + x
        means[j, 1] += y


@kernel
def fit(
    points: Samples, weights: Samples, means: Samples, covariances: Samples,
    turns: int, least: Samples, tolerance: float, most: int, before: float, scratch: Samples,
) -> tuple[int, float, bool]:  # fmt: skip
    """Sweep until the mean log-likelihood of a point gains less than `tolerance` over `before` (-inf at the start), at most `most` times.

    Returns how often, the mean log-likelihood before the last sweep, and whether that was the end; if not, the next call goes on.
    """
    for step in range(most):
        now = sweep(points, weights, means, covariances, turns, least, scratch)
        if abs(now - before) < tolerance:
            return step + 1, now, True
        before = now
    return most, before, False


@kernel
def nearest_on_cycle(places: Samples, centres: Samples, circular: bool, chosen: Samples) -> None:
    """The number of the nearest centre of each place, into `chosen` (n,); of two as near, the first."""
    for i in range(places.shape[0]):
        best = inf
        for j in range(centres.shape[0]):
            apart = abs(places[i] - centres[j])
            if circular:
                apart = min(apart, CYCLE - apart)
            if apart < best:
                best, chosen[i] = apart, j


@kernel
def cluster_places(places: Samples, centres: Samples, circular: bool, most: int, chosen: Samples) -> int:
    """k-means along the cycle (Lloyd's algorithm) from `centres` (k,) and into them; returns how often the centres moved.

    places  (n,) in %; chosen  (n,) the number of each place's cluster. A cluster that loses all its places keeps its centre.
    """
    for step in range(most):
        nearest_on_cycle(places, centres, circular, chosen)
        moved = False
        for j in range(centres.shape[0]):
            total, count = 0.0, 0
            for i in range(places.shape[0]):
                if chosen[i] == j:
                    apart = places[i] - centres[j]
                    if circular:
                        apart -= CYCLE * floor(apart / CYCLE + 0.5)
                    total += apart
                    count += 1
            if count and abs(total / count) > 1e-9:
                centres[j] += total / count
                if circular:
                    centres[j] = wrapped(centres[j])
                moved = True
        if not moved:
            return step
    return most


@kernel
def begin_mixture(
    points: Samples, chosen: Samples, centres: Samples, circular: bool, least: Samples,
    weights: Samples, means: Samples, covariances: Samples,
) -> int:  # fmt: skip
    """A first mixture, one mode for each cluster that has points; returns how many modes there are, in the first places of the arrays."""
    made = 0
    for j in range(centres.shape[0]):
        count, x, y = 0, 0.0, 0.0
        for i in range(points.shape[0]):
            if chosen[i] == j:
                apart = points[i, 0] - centres[j]
                if circular:
                    apart -= CYCLE * floor(apart / CYCLE + 0.5)
                count += 1
                x += apart
                y += points[i, 1]
        if not count:
            continue
        x, y = x / count, y / count
        xx = xy = yy = 0.0
        for i in range(points.shape[0]):
            if chosen[i] == j:
                apart = points[i, 0] - centres[j]
                if circular:
                    apart -= CYCLE * floor(apart / CYCLE + 0.5)
                dx, dy = apart - x, points[i, 1] - y
                xx += dx * dx
                xy += dx * dy
                yy += dy * dy
        weights[made] = count / points.shape[0]
        means[made, 0] = wrapped(centres[j] + x) if circular else centres[j] + x
        means[made, 1] = y
        covariances[made, 0], covariances[made, 1], covariances[made, 2] = (
            xx / count + least[0],
            xy / count,
            yy / count + least[1],
        )
        made += 1
    return made


def full(covariances: Samples) -> Samples:
    """Covariances (k, 3) as matrices (k, 2, 2)."""
    return np.ascontiguousarray(covariances[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
