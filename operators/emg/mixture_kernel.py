"""Bivariate Gaussian mixtures of activation peaks: a start by k-means along the cycle, and EM (thesis 6.2.4).

A peak is a point (place, height): the place in % of the cycle, 0 <= place < 100, the height in the curve's unit. Along the cycle a burst at
touch-down is one mode, so the density is that of a normal distribution wrapped around the cycle: the sum over `turns` turns to either side.
With turns = 0 it is the plain Gaussian mixture of the thesis, whose eq. 6.5 prints exponent and normaliser wrongly.

A mixture of k modes is three arrays: weights (k,), means (k, 2), covariances (k, 3) as (variance of place, covariance, variance of height).
"""

from __future__ import annotations

from math import exp, floor, inf, log, pi

import numpy as np

from stream.chunk import Samples
from stream.kernel import kernel

CYCLE = 100.0


@kernel
def wrapped(place: float) -> float:
    """A place on the cycle, 0 <= place < 100."""
    within = place - CYCLE * floor(place / CYCLE)
    return 0.0 if within >= CYCLE else within


@kernel
def expect(
    points: Samples, weights: Samples, means: Samples, covariances: Samples, turns: int, shares: Samples
) -> float:
    """How much each mode and turn accounts for each point; returns the mean log-likelihood of a point.

    points  (n, 2)
    shares  (n, k, 2 turns + 1), written; the shares of a point add up to 1
    """
    n, k, total = points.shape[0], weights.shape[0], 0.0
    for i in range(n):
        highest = -inf
        for j in range(k):
            a, b, c = covariances[j, 0], covariances[j, 1], covariances[j, 2]
            det = a * c - b * b
            base = (log(weights[j]) if weights[j] > 0.0 else -inf) - log(2.0 * pi) - 0.5 * log(det)
            dy = points[i, 1] - means[j, 1]
            for t in range(2 * turns + 1):
                dx = points[i, 0] + CYCLE * (t - turns) - means[j, 0]
                value = base - 0.5 * (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / det
                shares[i, j, t] = value
                highest = max(highest, value)
        mass = 0.0
        for j in range(k):
            for t in range(2 * turns + 1):
                shares[i, j, t] = exp(shares[i, j, t] - highest)
                mass += shares[i, j, t]
        for j in range(k):
            for t in range(2 * turns + 1):
                shares[i, j, t] /= mass
        total += highest + log(mass)
    return float(total / n)


@kernel
def maximise(
    points: Samples, shares: Samples, least: Samples, turns: int, weights: Samples, means: Samples, covariances: Samples
) -> None:
    """The mixture that the shares make likeliest; `least` (2,) is added to the variances of place and height (a mode of equal points)."""
    n, k = points.shape[0], weights.shape[0]
    for j in range(k):
        mass = x = y = 0.0
        for i in range(n):
            for t in range(2 * turns + 1):
                r = shares[i, j, t]
                mass += r
                x += r * (points[i, 0] + CYCLE * (t - turns))
                y += r * points[i, 1]
        weights[j] = mass / n
        if mass <= 0.0:
            continue  # a mode that accounts for nothing stays where it is, with no weight
        x /= mass
        y /= mass
        xx = xy = yy = 0.0
        for i in range(n):
            for t in range(2 * turns + 1):
                r = shares[i, j, t]
                dx, dy = points[i, 0] + CYCLE * (t - turns) - x, points[i, 1] - y
                xx += r * dx * dx
                xy += r * dx * dy
                yy += r * dy * dy
        means[j, 0] = wrapped(x) if turns else x
        means[j, 1] = y
        covariances[j, 0], covariances[j, 1], covariances[j, 2] = xx / mass + least[0], xy / mass, yy / mass + least[1]


@kernel
def fit(
    points: Samples, weights: Samples, means: Samples, covariances: Samples,
    turns: int, least: Samples, tolerance: float, most: int, shares: Samples,
) -> tuple[int, float]:  # fmt: skip
    """Expectation and maximisation in turn, from the mixture that is given and into it, until the mean log-likelihood of a point gains less
    than `tolerance`, at most `most` times. Returns how often, and the mean log-likelihood before the last maximisation.
    """
    before = -inf
    for step in range(most):
        now = expect(points, weights, means, covariances, turns, shares)
        maximise(points, shares, least, turns, weights, means, covariances)
        if abs(now - before) < tolerance:
            return step + 1, now
        before = now
    return most, before


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
