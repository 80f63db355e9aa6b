"""How far apart two mixtures are, in closed form, and modes of one that are too close to be two (thesis 6.3.2, 6.4.1)."""

from __future__ import annotations

from math import exp, floor, inf, log, pi, sqrt

from kinegraph.operators.emg.mixtures.kernel import CYCLE, wrapped
from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def overlap(
    weights: Samples, means: Samples, covariances: Samples,
    others: Samples, their_means: Samples, their_covariances: Samples, turns: int,
) -> float:  # fmt: skip
    """The integral of the product of two mixtures, over the cycle and all heights. Any two numbers of modes."""
    total = 0.0
    for i in range(weights.shape[0]):
        for j in range(others.shape[0]):
            a = covariances[i, 0] + their_covariances[j, 0]
            b = covariances[i, 1] + their_covariances[j, 1]
            c = covariances[i, 2] + their_covariances[j, 2]
            det = a * c - b * b
            dy = means[i, 1] - their_means[j, 1]
            for t in range(-turns, turns + 1):
                dx = means[i, 0] - their_means[j, 0] + CYCLE * t
                density = exp(-0.5 * (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / det) / (2.0 * pi * sqrt(det))
                total += weights[i] * others[j] * density
    return total


@kernel
def cauchy_schwarz(
    weights: Samples, means: Samples, covariances: Samples,
    others: Samples, their_means: Samples, their_covariances: Samples, turns: int,
) -> float:  # fmt: skip
    """The Cauchy-Schwarz divergence of two mixtures: 0 for the same, infinite where they do not overlap (thesis eq. 6.11).

    In closed form for any two numbers of modes; the thesis restricts it to equal ones, which is not necessary.
    """
    shared = overlap(weights, means, covariances, others, their_means, their_covariances, turns)
    own = overlap(weights, means, covariances, weights, means, covariances, turns)
    theirs = overlap(others, their_means, their_covariances, others, their_means, their_covariances, turns)
    if shared <= 0.0:
        return inf
    return max(0.0, 0.5 * (log(own) + log(theirs)) - log(shared))


@kernel
def kullback_leibler(means: Samples, covariances: Samples, i: int, j: int, circular: bool) -> float:
    """The symmetric Kullback-Leibler divergence of two modes (nat): the mean of both directions."""
    dx, dy = means[i, 0] - means[j, 0], means[i, 1] - means[j, 1]
    if circular:
        dx -= CYCLE * floor(dx / CYCLE + 0.5)
    total = 0.0
    for p, q in ((i, j), (j, i)):
        a, b, c = covariances[p, 0], covariances[p, 1], covariances[p, 2]
        d, e, f = covariances[q, 0], covariances[q, 1], covariances[q, 2]
        det, det_q = a * c - b * b, d * f - e * e
        trace = (f * a - 2.0 * e * b + d * c) / det_q
        far = (f * dx * dx - 2.0 * e * dx * dy + d * dy * dy) / det_q
        total += 0.5 * (trace + far - 2.0 + log(det_q / det))
    return 0.5 * total


@kernel
def merge_close_modes(
    weights: Samples, means: Samples, covariances: Samples, count: int, closer: float, circular: bool
) -> int:
    """Merge the two modes that diverge least, as long as that is less than `closer` nat (thesis 6.4.1); returns how many modes are left.

    A merged mode has the mean and the covariance of both (moments are kept). Modes beyond `count` are not looked at.
    """
    while count > 1:
        best, one, other = closer, -1, -1
        for i in range(count):
            for j in range(i + 1, count):
                apart = kullback_leibler(means, covariances, i, j, circular)
                if apart < best:
                    best, one, other = apart, i, j
        if one < 0:
            break
        w, v = weights[one], weights[other]
        share = v / (w + v) if w + v > 0.0 else 0.5
        dx, dy = means[other, 0] - means[one, 0], means[other, 1] - means[one, 1]
        if circular:
            dx -= CYCLE * floor(dx / CYCLE + 0.5)
        spread = share * (1.0 - share)
        for m in range(3):
            covariances[one, m] += share * (covariances[other, m] - covariances[one, m])
        covariances[one, 0] += spread * dx * dx
        covariances[one, 1] += spread * dx * dy
        covariances[one, 2] += spread * dy * dy
        means[one, 0] = wrapped(means[one, 0] + share * dx) if circular else means[one, 0] + share * dx
        means[one, 1] += share * dy
        weights[one] = w + v
        for k in range(other, count - 1):
            weights[k] = weights[k + 1]
            means[k] = means[k + 1]
            covariances[k] = covariances[k + 1]
        count -= 1
    return count
