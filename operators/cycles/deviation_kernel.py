"""How far cycles lie from their mean curve."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def deviations(kept: Samples, scale: int, mean: Samples, away: Samples, out: Samples) -> None:
    """Mean distance of each muscle's cycles to their mean curve, and the mean absolute deviation of the distances.

    kept (k, p, m)   cycles; one that starts with NaN does not count
    scale            0: as they are; 1: relative to the muscle's highest value; 2: each cycle relative to its own
    mean (p, m), away (k, m)   written over
    out  (2, m)      written; NaN where fewer than two cycles count
    """
    cycles, points, muscles = kept.shape
    for k in range(cycles):
        for m in range(muscles):
            away[k, m] = kept[k, 0, m]
        for p in range(1, points):
            for m in range(muscles):
                away[k, m] = max(away[k, m], kept[k, p, m])
    for m in range(muscles):
        top = -math.inf
        for k in range(cycles):
            if away[k, m] > top:
                top = away[k, m]
        for k in range(cycles):
            if not math.isnan(away[k, m]):
                away[k, m] = 1.0 if scale == 0 else 1.0 / (top if scale == 1 else away[k, m])
    mean[:] = 0.0
    for k in range(cycles):
        for p in range(points):
            for m in range(muscles):
                mean[p, m] += 0.0 if math.isnan(away[k, m]) else kept[k, p, m] * away[k, m]
    for m in range(muscles):
        count = 0
        for k in range(cycles):
            count += not math.isnan(away[k, m])
        out[0, m] = count
    for p in range(points):
        for m in range(muscles):
            mean[p, m] /= out[0, m]
    for k in range(cycles):
        for m in range(muscles):
            out[1, m] = 0.0
        for p in range(points):
            for m in range(muscles):
                apart = kept[k, p, m] * away[k, m] - mean[p, m]
                out[1, m] += apart * apart
        for m in range(muscles):
            away[k, m] = math.sqrt(out[1, m])
    for m in range(muscles):
        count, total, spread = int(out[0, m]), 0.0, 0.0
        for k in range(cycles):
            total += 0.0 if math.isnan(away[k, m]) else away[k, m]
        for k in range(cycles):
            spread += 0.0 if math.isnan(away[k, m]) else abs(away[k, m] - total / count)
        out[0, m] = total / count if count > 1 else math.nan
        out[1, m] = spread / count if count > 1 else math.nan
