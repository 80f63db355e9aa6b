"""What a training of a mesh has found, as one page: its parts, how far each vertex is off in frames left out, and its shape modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from kinegraph.operators.steering.model.fit import Steering
from kinegraph.operators.steering.model.part import Part
from kinegraph.operators.steering.model.turns import rigid
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.text.report import png, render

VIEWS = {"from the side": (2, 1, 0), "from the front": (0, 1, 2)}
"""Axes to the right and up, and the one that is looked along."""
FOLD = 4
Train = Callable[[Samples], Steering]


def write_report(
    path: Path,
    title: str,
    model: Steering,
    how: str,
    off: Mapping[Any, float],
    frames: Samples,
    faces: Array,
    train: Train,
    asked: Mapping[str, object] = {},
) -> float:
    """Write the page for `model`, made of `frames` (f, vertices, 3) as `how` says; `train` makes one of other frames in the same way;
    `asked` are the options it was made with.

    Returns by how much the vertices are off in every fourth frame, left out of a training of the others (percent of the diagonal; with less
    than four frames: of the frames trained).
    """
    errors = left_out(frames, train) if len(frames) >= FOLD else errors_of(model, frames)
    near_rigid = [part for part in model.parts if how in ("parts", "local") or part is not model.parts[-1]] or list(
        model.parts
    )
    owner = np.full(frames.shape[1], -1)
    weight = np.zeros(frames.shape[1])
    for k, part in enumerate(near_rigid):
        more = part.weights > weight[part.vertices]
        owner[part.vertices[more]], weight[part.vertices[more]] = k, part.weights[more]
    colours = mpl.colormaps["tab20"](owner % 20)
    heat = mpl.colormaps["viridis"](np.clip(errors / max(float(np.percentile(errors, 99)), 1e-9), 0, 1))
    shares = [explained(part, frames) for part in near_rigid]
    rows = [(name, f"{error:.3f} %", "chosen" if name == how else "") for name, error in off.items()]
    facts = [facts_of(model, k, part, share) for k, (part, share) in enumerate(zip(near_rigid, shares, strict=True))]
    summary = (
        f"{len(frames)} frames of {frames.shape[1]} vertices, {len(model.markers)} markers: {', '.join(model.markers)}. In "
        f"every fourth frame, left out of a training of the others, vertices are off by {errors.mean():.3f} % of the mesh's "
        f"diagonal in the mean over the mesh, by {errors.max():.2f} % where it is worst."
    )
    page = render(
        Path(__file__).with_name("page.html.j2"), title, summary=summary, rows=rows, asked=list(asked.items()),
        parts=picture(frames[0], faces, colours), facts=facts, worst=np.percentile(errors, 99),
        errors=picture(frames[0], faces, heat), modes=curves(shares),
    )  # fmt: skip
    path.write_text(page, encoding="utf-8")
    return float(errors.mean())


def left_out(frames: Samples, train: Train) -> Samples:
    """By how much each vertex (v,) is off in every fourth frame, by a model of the others; percent of the diagonal."""
    out = np.arange(len(frames)) % FOLD == 0
    return errors_of(train(frames[~out]), frames[out])


def errors_of(model: Steering, frames: Samples) -> Samples:
    """By how much each vertex (v,) is off in the mean of `frames` (f, v, 3); percent of the diagonal."""
    made = model(frames[:, model.vertices], frames.shape[1])
    diagonal = float(np.linalg.norm(np.ptp(frames[0], axis=0)))
    return np.asarray(100.0 * np.linalg.norm(made - frames, axis=-1).mean(axis=0) / diagonal)


def facts_of(model: Steering, k: int, part: Part, share: Samples) -> tuple[str, ...]:
    """A row of the table of parts."""
    follows = model.alone(part) or "all markers"
    learned = part.learned
    shown = f"{100 * share[-1]:.0f} %" if len(share) else "-"
    return str(k), str(len(part.vertices)), follows, f"{learned.width:g}", f"{learned.ridge:g}", shown


def explained(part: Part, frames: Samples) -> Samples:
    """What share of a part's change of shape its first modes explain: (modes,)."""
    points, shapes = frames[:, part.vertices], []
    for frame in points:
        turn, move = rigid(part.mean, frame)
        shapes.append(((frame - move) @ turn - part.mean).ravel())
    changes = np.array(shapes) - np.mean(shapes, axis=0)
    whole = float((changes**2).sum())
    return np.asarray(
        np.cumsum(((changes @ part.modes.T) ** 2).sum(axis=0)) / whole if whole > 0 else np.ones(len(part.modes))
    )


def picture(points: Samples, faces: Array, colours: Samples) -> Markup:
    """The mesh (v, 3) from two sides, each triangle in the mean of its vertices' `colours` (v, 4), shaded."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    corners = points[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    for axes, (name, (right, up, depth)) in zip(figure.subplots(1, len(VIEWS)), VIEWS.items(), strict=True):
        order = np.argsort(corners[:, :, depth].mean(axis=1))
        shade = 0.45 + 0.55 * np.abs(normals[:, depth])
        tint = colours[np.asarray(faces)].mean(axis=1)
        tint[:, :3] *= shade[:, None]
        axes.add_collection(PolyCollection(corners[order][:, :, [right, up]], facecolors=tint[order], linewidths=0))
        axes.autoscale_view()
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(name, fontsize=10)
    return png(figure, "the mesh from two sides")


def curves(shares: list[Samples]) -> Markup:
    """What the first modes of each part explain."""
    figure = Figure(figsize=(9, 3.5), layout="constrained")
    axes = figure.subplots()
    for k, share in enumerate(shares):
        axes.plot(np.arange(len(share) + 1), [0.0, *(100 * share)], marker=".", label=str(k))
    axes.set(xlabel="modes", ylabel="explained, %", ylim=(0, 102))
    if len(shares) <= 20:
        axes.legend(title="part", ncols=2, fontsize=8)
    return png(figure, "what shape modes explain")
