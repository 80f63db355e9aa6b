"""Parts, or straight to the vertices: whichever predicts frames better that were left out (thesis 9.3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np

from operators.steering.fit import Layout, Steering, fit_steering, fit_straight
from stream.chunk import Array, Samples

Method: TypeAlias = Literal["parts", "straight"]
FOLDS = 4


def choose(
    frames: Samples,
    faces: Array,
    markers: Mapping[str, int],
    reference: Sequence[str],
    limbs: Sequence[str] = (),
    count: int = 14,
    modes: int = 4,
    heading: Sequence[str] = (),
    method: Method | None = None,
) -> tuple[Steering, Method, dict[Method, float]]:
    """A model of a mesh's `frames` (f, vertices, 3), how it was made, and what each way's vertices are off by, in percent of the mesh's
    diagonal, in frames left out.

    Every fourth frame is left out in turn, four times; only the borders of the parts are those of all frames. Limbs that move by
    themselves need parts, and so do fewer than eight frames. Nothing is left out where `method` says what to make.
    """
    at = np.array(list(markers.values()), np.int64)
    if method == "straight":
        return fit_straight(frames, markers, reference, heading), "straight", {}
    layout = Layout.of(frames, faces, at, count)

    def parts(rows: Samples) -> Steering:
        return fit_steering(rows, faces, markers, reference, limbs, count, modes, heading, layout)

    def straight(rows: Samples) -> Steering:
        return fit_straight(rows, markers, reference, heading)

    if method == "parts" or limbs or len(frames) < 2 * FOLDS:
        return parts(frames), "parts", {}
    diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))
    off: dict[Method, float] = {"parts": 0.0, "straight": 0.0}
    for fold in range(FOLDS):
        out = np.arange(len(frames)) % FOLDS == fold
        for name, way in (("parts", parts), ("straight", straight)):
            made = way(frames[~out])(frames[out][:, at], frames.shape[1])
            distance = np.linalg.norm(made - frames[out], axis=-1).mean(axis=1).sum()
            off[name] += 100.0 * float(distance) / diagonal / len(frames)  # type: ignore[index]
    best: Method = min(off, key=lambda way: off[way])
    return (parts if best == "parts" else straight)(frames), best, off
