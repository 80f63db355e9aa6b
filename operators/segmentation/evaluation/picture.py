"""A picture of a segmentation: the sparse self-similarity matrix with segments, and coloured bars below the signals (thesis 2.4-2.7)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.truth import Truth
from kinegraph.stream.chunk import Array, Samples

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_FRAMES = 1500
"""Longer recordings are shown with every n-th frame."""
MOST_LINES = 24
"""Signals with more channels are shown by as many of them."""
NEAREST = 0.06
"""The share of pairs of frames that are shown as near where the radius is not known."""
LETTER = 0.011
"""The share of the picture's width that a letter of a name takes."""
TRANSITION, NONE = "#202020", "#d0d0d0"
"""Colours of transitions in annotations, and of what is in no cluster."""


def draw(name: str, found: Found, truth: Truth | None, radius: float = np.nan) -> Figure:
    """The picture of one recording: above the matrix, if features are known, below them the signals with their bars.

    Matrix: pairs of frames within the radius, the nearer the darker; green squares are activities, red lines primitives; beside it the
    annotated actions. Bars: annotated actions (black: transition), activities (black: transition), primitives by cluster (grey: without).
    """
    from matplotlib.figure import Figure

    shown = len(found.features) > 0
    rows = [3.0, 0.25, 0.25, 0.25] if shown else [0.4, 0.4, 0.4]
    figure = Figure(figsize=(9, 13 if shown else 2.6), layout="constrained")
    outer = figure.add_gridspec(2, 1, height_ratios=[9, 3.4]) if shown else figure.add_gridspec(1, 1)
    length = float(
        max(
            [*found.activities[:, 1], *found.primitives[:, 1], *found.time[-1:], *(truth.end if truth else [])],
            default=1.0,
        )
    )
    if shown:
        inside = outer[0].subgridspec(1, 2, width_ratios=[0.03, 1.0], wspace=0.02)
        side, matrix = figure.add_subplot(inside[0]), figure.add_subplot(inside[1])
        _matrix(matrix, found, radius if radius == radius else found.radius, length)
        _bar(side, _truth_bars(truth), length, upright=True)
        _name(side, truth, length, upright=True)
        side.set(ylabel="annotated (s)" if truth else "s")
    below = outer[-1].subgridspec(len(rows), 1, height_ratios=rows, hspace=0.05)
    axes = [figure.add_subplot(below[i]) for i in range(len(rows))]
    if shown:
        lines = found.features[:, slice(*found.own)]
        lines = lines[:, :: -(-lines.shape[1] // MOST_LINES)]
        every = max(1, len(found.features) // (4 * MOST_FRAMES))
        axes[0].plot(found.time[::every], lines[::every], linewidth=0.6)
        axes[0].set(xlim=(0, length), xticks=[], ylabel="features")
    kinds = [
        ("annotated", _truth_bars(truth)),
        ("activities", _activity_bars(found)),
        ("primitives", _primitive_bars(found)),
    ]
    for axis, (label, bars) in zip(axes[-3:], kinds, strict=True):
        _bar(axis, bars, length)
        axis.set_ylabel(label, rotation=0, ha="right", va="center", fontsize=8)
    _name(axes[-3], truth, length)
    for key in truth.keys if truth else []:
        axes[-1].axvline(key, color="red", linewidth=1.0)
    axes[-1].set(xlabel="s", xticks=np.arange(0.0, length, _ticks(length)))
    figure.suptitle(name, fontsize=9)
    return figure


Bars = list[tuple[float, float, str]]
"""Start, end, colour."""


def _matrix(axes: Axes, found: Found, radius: float, length: float) -> None:
    step = -(-len(found.features) // MOST_FRAMES)
    time, data = found.time[::step], found.features[::step].astype(np.float32)
    apart = distances(data)
    if not radius > 0.0:
        values = apart[np.triu_indices(len(apart), 1)]
        values = values[np.isfinite(values)]
        radius = float(np.quantile(values, NEAREST)) if len(values) else 1.0
    image = np.where(apart <= radius, 1.0 - 0.85 * apart / radius, np.nan)
    edges = (float(time[0]), float(time[-1]), float(time[-1]), float(time[0]))
    axes.imshow(image, cmap="Blues", vmin=0.0, vmax=1.0, extent=edges, interpolation="nearest", aspect="auto")
    for start, end in found.activities:
        axes.plot([start, end, end, start, start], [start, start, end, end, start], color="green", linewidth=1.2)
    within = found.repetition > 0
    for start, end in found.primitives[within]:
        home = next((a for a in found.activities if a[0] <= start < a[1]), (start, end))
        for cut in (start, end):
            axes.plot([home[0], cut], [cut, cut], color="red", linewidth=0.4)
            axes.plot([cut, cut], [cut, home[1]], color="red", linewidth=0.4)
    axes.set(xlim=(0, length), ylim=(length, 0), yticks=[], xlabel="s", title=f"nearer than {radius:.3g}")
    axes.title.set_fontsize(8)


def distances(data: Array) -> Array:
    """Euclidean distances (n, n) between frames (n, width); NaN where a frame has bad values."""
    squares = (data * data).sum(axis=1)
    made: Array = np.sqrt(np.maximum(squares[:, None] + squares[None, :] - 2.0 * (data @ data.T), 0.0))
    return made


def _truth_bars(truth: Truth | None) -> Bars:
    if truth is None:
        return []
    names = list(dict.fromkeys(truth.label))
    bars: Bars = []
    before = 0.0
    for start, end, label in zip(truth.start, truth.end, truth.label, strict=True):
        bars += [(before, start, TRANSITION), (start, end, _colour(names.index(label)))]
        before = end
    return bars


def _activity_bars(found: Found) -> Bars:
    """Activities in the colour of the cluster that most of their primitives are in."""
    numbers = _order(found.cluster)
    bars: Bars = []
    for (start, end), transition in zip(found.activities, found.transition, strict=True):
        inside = (found.primitives.mean(axis=1) >= start) & (found.primitives.mean(axis=1) < end) & (found.cluster >= 0)
        mine, counts = np.unique(found.cluster[inside], return_counts=True)
        colour = _colour(numbers[int(mine[counts.argmax()])]) if len(mine) else NONE
        bars.append((start, end, TRANSITION if transition else colour))
    return bars


def _primitive_bars(found: Found) -> Bars:
    numbers = _order(found.cluster)
    return [
        (start, end, _colour(numbers[int(cluster)]) if cluster >= 0 else NONE)
        for (start, end), cluster in zip(found.primitives, found.cluster, strict=True)
    ]


def _order(cluster: Samples | Array) -> dict[int, int]:
    """Clusters by first appearance."""
    return {int(number): k for k, number in enumerate(dict.fromkeys(cluster[cluster >= 0].tolist()))}


def _colour(number: int) -> str:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return to_hex(colormaps["tab20"]((2 * number + number // 10) % 20))


def _bar(axes: Axes, bars: Bars, length: float, *, upright: bool = False) -> None:
    for start, end, colour in bars:
        span = axes.axhspan if upright else axes.axvspan
        span(start, end, color=colour, linewidth=0)
        (axes.axhline if upright else axes.axvline)(end, color="white", linewidth=0.6)
    if upright:
        axes.set(ylim=(length, 0), xticks=[])
    else:
        axes.set(xlim=(0, length), xticks=[], yticks=[])


def _name(axes: Axes, truth: Truth | None, length: float, *, upright: bool = False) -> None:
    """Write the annotated actions' names into their bars, where there is room."""
    for start, end, label in zip(truth.start, truth.end, truth.label, strict=True) if truth else ():
        if (end - start) / length >= LETTER * len(label):
            x, y = (0.5, (start + end) / 2.0) if upright else ((start + end) / 2.0, 0.5)
            axes.text(x, y, label, rotation=90 if upright else 0, ha="center", va="center", fontsize=7, color="white")


def _ticks(length: float) -> float:
    return next((step for step in (1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0) if length / step <= 20), 600.0)
