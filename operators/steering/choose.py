"""Parts, straight to the vertices, or the mean of both: whichever predicts frames best that were left out (thesis 9.3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from operators.steering.fit import Layout, Steering, fit_steering, fit_straight
from stream.chunk import Array, Samples

Method: TypeAlias = Literal["parts", "straight", "both"]
METHODS: tuple[Method, ...] = get_args(Method)
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
    themselves need parts, and so do fewer than eight frames. Nothing is left out where `method` says what to make. The mean of both costs
    as much as both together; their errors differ, and so it is mostly better than either, and taken where it is not clearly worse.
    """
    at = np.array(list(markers.values()), np.int64)
    layout = None if method == "straight" else Layout.of(frames, faces, at, count)

    def made(rows: Samples, way: Method) -> Steering:
        if way == "straight":
            return fit_straight(rows, markers, reference, heading)
        parts = fit_steering(rows, faces, markers, reference, limbs, count, modes, heading, layout)
        return parts if way == "parts" else mean_of(parts, fit_straight(rows, markers, reference, heading))

    if method or limbs or len(frames) < 2 * FOLDS:
        return made(frames, method or "parts"), method or "parts", {}
    diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))
    off = {way: np.zeros(len(frames)) for way in METHODS}
    for fold in range(FOLDS):
        out = np.arange(len(frames)) % FOLDS == fold
        parts, straight = (
            made(frames[~out], way)(frames[out][:, at], frames.shape[1]) for way in ("parts", "straight")
        )
        for way, there in (("parts", parts), ("straight", straight), ("both", (parts + straight) / 2)):
            off[way][out] = 100.0 * np.linalg.norm(there - frames[out], axis=-1).mean(axis=1) / diagonal  # type: ignore[index]
    best = best_of(off)
    return made(frames, best), best, {way: float(frame.mean()) for way, frame in off.items()}


def best_of(off: Mapping[Method, Samples]) -> Method:
    """The best way by what each was off in every frame left out (f,); both, if that is no worse by a standard error of the difference."""
    best = min(off, key=lambda way: float(off[way].mean()))
    worse = off["both"] - off[best]
    return "both" if worse.mean() <= worse.std(ddof=1) / np.sqrt(len(worse)) else best


def mean_of(one: Steering, other: Steering) -> Steering:
    """The model that puts every vertex in the middle between where two models of the same markers put it."""
    halves = (replace(part, weights=part.weights / 2) for part in (*one.parts, *other.parts))
    return replace(one, parts=tuple(halves))
