"""The curves of a comparison: each muscle's mean curves over one another, and below them where the first two differ."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kinegraph.operators.emg.commands.comparison import Band, Comparison
from kinegraph.stream.text.report import COLOURS, STYLE, svg
from kinegraph.stream.text.units import shown

WITH_BANDS = 4
"""Up to this many sessions have a band of one standard deviation each; more are mean curves alone."""
SIZE_IN = (3.6, 3.0)
PLACE = np.arange(100)


def draw_curves(found: Comparison) -> list[Markup]:
    """One SVG element per muscle."""
    with rc_context(STYLE | {"font.size": 7}):
        return [_drawn(found, band) for band in found.bands]


def _drawn(found: Comparison, band: Band) -> Markup:
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    _means(above, found, band)
    _difference(below, found, band)
    return svg(figure, band.name)


def _means(axes: Axes, found: Comparison, band: Band) -> None:
    muscle, group = band.muscle, band.group.members
    for k, place in enumerate(group):
        mean, sd, colour = found.means[muscle][place], found.sds[muscle][place], COLOURS[k % len(COLOURS)]
        axes.plot(PLACE, mean, color=colour, linewidth=1.0, label=found.labels[place])
        if len(group) <= WITH_BANDS:
            axes.fill_between(PLACE, mean - sd, mean + sd, color=colour, alpha=0.18, linewidth=0)
    axes.set_title(band.name, loc="left", fontsize=8)
    axes.set_ylim(bottom=0)
    axes.set_ylabel(shown(str(found.alike["height_unit"] or "")))
    axes.legend(frameon=False, fontsize=6)


def _difference(axes: Axes, found: Comparison, band: Band) -> None:
    axes.axhline(0.0, color="#888888", linewidth=0.5)
    axes.plot(PLACE, band.difference, color="#222222", linewidth=1.0)
    low, high = band.difference - band.width, band.difference + band.width
    axes.fill_between(PLACE, low, high, color="#222222", alpha=0.15, linewidth=0)
    for edge in (-band.relevant, band.relevant):
        axes.axhline(edge, color="#b25b00", linewidth=0.6, linestyle=":")
    for p in band.places:
        axes.axvspan(p - 0.5, p + 0.5, color="#f0c9a0", alpha=0.6, linewidth=0, zorder=0)
    axes.set_xlim(0, 99)
    axes.set_xlabel("% of the cycle")
    first, second = (found.labels[place] for place in band.pair)
    axes.set_ylabel(f"{second} less\n{first}" if max(len(first), len(second)) < 14 else "difference")
