"""All regions of a mesh that go straight to the vertices, a sample in one piece of compiled code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.steering.model.assemble_kernel import apart, columns, predict
from kinegraph.operators.steering.model.marker_frame import see_from
from kinegraph.operators.steering.model.part import Part
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import record
from kinegraph.stream.kernel import kernel


@record
@dataclass(frozen=True, slots=True)
class Regions:
    """Parts that move with frames of markers, one after the other in one array each.

    begins                    (p + 1,)                    where each region's vertices begin
    vertices, weights, mean   (n,), (n,), (n, 3)          as in `Part`
    modes                     (k, 3 n) float32            float32 halves what a sample reads; k is the most that any region has, 0 beyond
    counts, places, shares    (p, m), (p, m, 3), (p, m)   the weights, usual places and shares of each `MarkerFrame`
    centres, ridge, usual     (p, f, 3 m), (p, f, 9 + k), (p, 9 + k)  and scales (p,): as in `Learned`
    """

    begins: Times
    vertices: Times
    weights: Samples
    mean: Samples
    modes: Array
    counts: Samples
    places: Samples
    shares: Samples
    centres: Samples
    ridge: Samples
    usual: Samples
    scales: Samples

    @staticmethod
    def of(parts: Sequence[Part]) -> Regions | None:
        """None where not all parts move with frames of markers, or were learned from as many poses."""
        frames = [part.frame for part in parts if part.frame]
        if len(frames) < len(parts) or len({len(part.learned.centres) for part in parts}) > 1:
            return None
        begins = np.cumsum([0, *(len(part.vertices) for part in parts)])
        most = max(len(part.modes) for part in parts)
        modes = np.zeros((most, 3 * begins[-1]), np.float32)
        for part, begin in zip(parts, begins, strict=False):
            modes[: len(part.modes), 3 * begin : 3 * (begin + len(part.vertices))] = part.modes
        ridge, usual = np.zeros((len(parts), len(parts[0].learned.centres), 9 + most)), np.zeros((len(parts), 9 + most))
        for k, part in enumerate(parts):
            ridge[k, :, : 9 + len(part.modes)] = part.learned.weights
            usual[k, : 9 + len(part.modes)] = part.learned.mean
        vertices, weights = (np.concatenate([getattr(part, one) for part in parts]) for one in ("vertices", "weights"))
        counts, places, shares = (
            np.stack([getattr(frame, one) for frame in frames]) for one in ("weights", "usual", "shares")
        )
        return Regions(
            begins, vertices, weights, np.concatenate([part.mean for part in parts]), modes, counts, places, shares,
            np.stack([part.learned.centres for part in parts]), ridge, usual, np.array([part.learned.scale for part in parts]),
        )  # fmt: skip

    def add(self, marks: Samples, out: Samples) -> float:
        """Add the regions to the vertices `out` (v, 3), by the markers (m, 3) of a sample. How far these are from the training, in kernel
        widths (the largest of all regions)."""
        return float(add_regions(marks, self, out))

    def outside(self, marks: Samples, enough: float) -> float:
        """How far a sample's markers (m, 3) are from the training, the largest of all regions; or the first larger than `enough`."""
        return float(regions_outside(marks, self, enough))


@kernel
def regions_outside(marks: Samples, regions: Regions, enough: float) -> float:
    """`Regions.outside`."""
    features, room, pose, every = (
        np.empty(3 * marks.shape[0]),
        np.empty((11, 4)),
        np.empty(9),
        np.arange(3 * marks.shape[0]),
    )
    counts, places, shares, centres = regions.counts, regions.places, regions.shares, regions.centres
    far = 0.0
    for r in range(counts.shape[0]):
        see_from(marks, counts[r], places[r], shares[r], pose, features, room)
        least = math.inf
        for f in range(centres.shape[1]):
            least = min(least, apart(features, every, centres[r, f]))
        far = max(far, math.sqrt(2.0 * regions.scales[r] * least))
        if far > enough:
            break
    return far


@kernel
def add_regions(marks: Samples, regions: Regions, out: Samples) -> float:
    """`Regions.add`."""
    features, room, turn = np.empty(3 * marks.shape[0]), np.empty((11, 4)), np.empty((3, 3))
    pose, y, every = np.empty(9), np.empty(regions.usual.shape[1]), np.arange(3 * marks.shape[0])
    begins, vertices, weights, mean, modes = (
        regions.begins,
        regions.vertices,
        regions.weights,
        regions.mean,
        regions.modes,
    )
    far = 0.0
    for r in range(begins.shape[0] - 1):
        first, n = begins[r], begins[r + 1] - begins[r]
        see_from(marks, regions.counts[r], regions.places[r], regions.shares[r], pose, features, room)
        ridge, usual = regions.ridge[r], regions.usual[r]
        far = max(far, predict(features, every, regions.centres[r], ridge, usual, regions.scales[r], y))
        columns(pose, turn)
        shape, spread = np.empty(3 * n), math.sqrt(n)
        for i in range(n):
            for a in range(3):
                shape[3 * i + a] = mean[first + i, a]
        for m in range(modes.shape[0]):  # mode by mode, which goes through memory in order
            s, row = spread * y[9 + m], modes[m, 3 * first : 3 * (first + n)]
            for i in range(3 * n):
                shape[i] += s * row[i]
        for i in range(n):
            w, v = weights[first + i], vertices[first + i]
            for a in range(3):
                x = turn[a, 0] * shape[3 * i] + turn[a, 1] * shape[3 * i + 1] + turn[a, 2] * shape[3 * i + 2]
                out[v, a] += w * (x + pose[6 + a])
    return far
