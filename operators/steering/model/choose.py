"""Parts, straight to the vertices, the mean of both, or region by region: what predicts frames best that were left out (9.3.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from kinegraph.operators.steering.model.fit import (
    USUAL,
    Layout,
    PoseRegression,
    Steering,
    fit_steering,
    fit_straight,
    untrained,
)
from kinegraph.operators.steering.model.local import fit_local
from kinegraph.operators.steering.model.parts import along_surface, edges_of, seams_of
from kinegraph.operators.steering.model.pose_parameters import PoseKind, backward, marker_graph
from kinegraph.operators.steering.model.regression import Regression
from kinegraph.operators.steering.model.settling import SoftShapes, offered
from kinegraph.operators.steering.model.soft import MarkerPull, felt, pulled
from kinegraph.stream.chunk import Array, Samples, Times

Method: TypeAlias = Literal["parts", "straight", "both", "local"]
METHODS: tuple[Method, ...] = get_args(Method)
TRIED: tuple[Method, ...] = ("parts", "straight", "both", "local")
"""What is tried where no method is given; regions only by positions of markers, and by kernels, and for the body that they lie on."""
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
    pull: MarkerPull | None = None,
    how: PoseRegression = USUAL,
    performed: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Steering, Method, dict[Method, float], MarkerPull | None]:
    """A model of a mesh's `frames` (f, vertices, 3), how it was made, what each way's vertices are off by, in percent of the mesh's
    diagonal, in frames left out, and how its markers pull.

    Every fourth frame is left out in turn, four times; only the borders of the parts are those of all frames. Limbs that move by
    themselves need parts, and so do fewer than eight frames; nothing is left out then, and no marker pulls. Of `method` and `pull`, what
    is given is not chosen; regions (`local`) are tried only where markers lie on this body: not where they are `performed`. The mean of
    both costs as much as both together; their errors differ, and so it is mostly better than either, and taken where it is not clearly
    worse. `progress` is called with how many models are made, and of how many.
    """
    at = np.array(list(markers.values()), np.int64)
    layout = None if method in ("straight", "local") else Layout.of(frames, faces, at, count)
    diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))

    earlier = backward(frames[:, at])

    def made(rows: Samples, way: Method, before: Samples = earlier) -> Steering:
        if way == "local":
            return fit_local(rows, faces, markers, reference, heading)
        if way == "straight":
            return fit_straight(rows, markers, reference, heading, how, before)
        parts = fit_steering(rows, faces, markers, reference, limbs, count, modes, heading, layout, how, before)
        return parts if way == "parts" else mean_of(parts, fit_straight(rows, markers, reference, heading, how, before))

    def soft(model: Steering, apart: Samples, by: MarkerPull | None) -> Steering:
        return replace(model, soft=felt(apart, at, by), most=by.most) if by else model

    if how.shapes and len(frames) >= 2 * FOLDS:
        shapes, off_by = softest(frames, at, diagonal, lambda rows, before: made(rows, "parts", before), progress)
        model = made(frames, "parts")
        assert model.settling
        return replace(model, settling=model.settling.by(shapes, diagonal)), "parts", {"parts": off_by}, None
    if limbs or how.settled or how.shared or len(frames) < 2 * FOLDS:
        return made(frames, method or "parts"), method or "parts", {}, None
    edges = np.concatenate([edges_of(faces), seams_of(frames)])
    apart = along_surface(at, edges, frames[0]) / diagonal
    if method and pull:
        return soft(made(frames, method), apart, pull), method, {}, pull
    tried = TRIED if how == USUAL and not performed else TRIED[:-1]
    ways: tuple[Method, ...] = (method,) if method else tried
    alone: list[Method] = [
        way for way in tried if way != "both" and (method in (None, way) or (method == "both" and way != "local"))
    ]
    models = FOLDS * len(alone) + 1
    off = left_out(frames, at, ways, alone, made, lambda done: progress(done, models))
    found = {way: pulled(off[way], apart, at) for way in ways}
    error = {way: 100.0 * np.linalg.norm(left, axis=-1).mean(axis=1) / diagonal for way, (_, left) in found.items()}
    best = method or best_of(error)
    progress(models - 1, models)
    model = soft(made(frames, best), apart, found[best][0])
    return model, best, {way: float(frame.mean()) for way, frame in error.items()}, found[best][0]


def left_out(
    frames: Samples,
    at: Times,
    ways: Sequence[Method],
    alone: Sequence[Method],
    made: Callable[[Samples, Method, Samples], Steering],
    progress: Callable[[int], None],
) -> dict[Method, Samples]:
    """What each way's vertices are off by, (f, vertices, 3), in frames on which it was not trained: every fourth in turn. Models are
    `made` by the ways that stand `alone`; of "both" they are the mean of two. `progress` is called with how many there are already."""
    earlier = backward(frames[:, at])
    off = {way: np.zeros_like(frames) for way in ways}
    for fold in range(FOLDS):
        out = np.arange(len(frames)) % FOLDS == fold
        marks, there = frames[out][:, at], dict[Method, Samples]()
        for k, way in enumerate(alone):
            progress(fold * len(alone) + k)
            there[way] = made(frames[~out], way, earlier[~out])(marks, frames.shape[1], earlier[out])
        if "both" in ways:
            there["both"] = (there["parts"] + there["straight"]) / 2
        for way in ways:
            off[way][out] = frames[out] - there[way]
    return off


def softest(
    frames: Samples,
    at: Times,
    diagonal: float,
    made: Callable[[Samples, Samples], Steering],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[SoftShapes, float]:
    """How shapes are best moved against their neighbours and the markers `at` (m,), and what vertices are then off by (percent of the
    `diagonal`), in frames left out; `made` fits a model to frames and where the markers were before each."""
    earlier, off = backward(frames[:, at]), dict.fromkeys(offered(), 0.0)
    for fold in range(FOLDS):
        progress(fold, FOLDS)
        out = np.arange(len(frames)) % FOLDS == fold
        model = made(frames[~out], earlier[~out])
        assert model.settling
        for one in off:
            moved = replace(model, settling=model.settling.by(one, diagonal))
            there = moved(frames[out][:, at], frames.shape[1], earlier[out])
            off[one] += 100.0 * float(np.linalg.norm(frames[out] - there, axis=-1).sum()) / diagonal
    best = min(off, key=lambda one: off[one])
    return best, off[best] / frames[..., 0].size


def regression_of(
    frames: Samples,
    faces: Array,
    markers: Mapping[str, int],
    reference: Sequence[str],
    limbs: Sequence[str] = (),
    heading: Sequence[str] = (),
    pose: PoseKind = "positions",
    regression: Regression = "kernel",
    skeleton: bool = False,
    greedy: bool = False,
    optimised: bool = False,
    shared: bool = False,
) -> PoseRegression:
    """How the markers of a mesh are to be turned into poses; the reference edge joins the first two markers of `reference`.

    Raises ValueError where there are not two, or no marker beside them.
    """
    bare = PoseRegression(None, regression, skeleton, greedy, SoftShapes() if optimised else None, shared)
    if pose == "positions":
        return bare
    names, at = list(markers), np.array(list(markers.values()), np.int64)
    if len(reference) < 2 or len(names) < 3:
        raise ValueError(
            "angles are measured against an edge between two reference markers, of at least one marker more"
        )
    _, _, x = untrained(frames, markers, reference, heading)
    lead = (names.index(reference[0]), names.index(reference[1]))
    graph = marker_graph(x.reshape(len(x), -1, 3), frames, faces, at, lead, pose, [names.index(one) for one in limbs])
    return replace(bare, graph=graph)


def best_of(off: Mapping[Method, Samples]) -> Method:
    """The best way by what each was off in every frame left out (f,); both, if that is no worse by a standard error of the difference."""
    best = min(off, key=lambda way: float(off[way].mean()))
    worse = off["both"] - off[best]
    return "both" if worse.mean() <= worse.std(ddof=1) / np.sqrt(len(worse)) else best


def mean_of(one: Steering, other: Steering) -> Steering:
    """The model that puts every vertex in the middle between where two models of the same markers put it."""
    halves = (replace(part, weights=part.weights / 2) for part in (*one.parts, *other.parts))
    return replace(one, parts=tuple(halves))
