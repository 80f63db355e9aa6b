"""How far one repetition is from another, whichever phase each was cut at: warping in time, distances over what both know."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

PHASES = 8
"""The other repetition may begin at this many phases of the cycle."""
LONGER = 3
"""Of two repetitions of a kind neither takes more than this many times as long as the other."""


@kernel
def apart(x: Samples, y: Samples, out: Samples) -> None:
    """Distances `out` (n, m) of frames x (n, features) to frames y (m, features): Euclidean, over the root of the number of features
    that both have; infinity where they have no feature in common."""
    for i in range(x.shape[0]):
        for j in range(y.shape[0]):
            squares, common = 0.0, 0
            for d in range(x.shape[1]):
                far = x[i, d] - y[j, d]
                if math.isfinite(far):
                    squares += far * far
                    common += 1
            out[i, j] = math.sqrt(squares / common) if common else math.inf


@kernel
def warped(far: Samples, phase: int, cost: Samples) -> float:
    """Mean distance along the cheapest warping path from the first frames to the last; columns begin at `phase` and go round.

    far (n, m); cost (2, m). Steps (1,1) weigh 2, (1,0) and (0,1) weigh 1.
    """
    n, m = far.shape
    for i in range(n):
        for c in range(m):
            step = far[i, (c + phase) % m]
            best = 2.0 * step if i == 0 and c == 0 else math.inf
            if i > 0:
                best = min(best, cost[0, c] + step)
            if c > 0:
                best = min(best, cost[1, c - 1] + step)
            if i > 0 and c > 0:
                best = min(best, cost[0, c - 1] + 2.0 * step)
            cost[1, c] = best
        for c in range(m):
            cost[0, c] = cost[1, c]
    return float(cost[0, m - 1] / (n + m))


@kernel
def unlike(x: Samples, y: Samples, far: Samples, cost: Samples) -> float:
    """How far repetition x (n, features) is from y (m, features), at the phase at which it is least; infinity: not of one kind.

    far, cost   room for (n, m) and (2, m) numbers
    """
    n, m = x.shape[0], y.shape[0]
    if n == 0 or m == 0 or n > LONGER * m or m > LONGER * n:
        return math.inf
    table = far[:n, :m]
    apart(x, y, table)
    best = math.inf
    for k in range(PHASES):
        best = min(best, warped(table, k * m // PHASES, cost))
    return best
