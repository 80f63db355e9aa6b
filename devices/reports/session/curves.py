"""The curves of a report: one small SVG a muscle, drawn by matplotlib, with the page's own fonts."""

from __future__ import annotations

from itertools import cycle, pairwise

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from kinegraph.devices.reports.session.contents.data import Curves, LimbPanel
from kinegraph.stream.chunk import Samples
from kinegraph.stream.text.report import COLOURS, INK, STYLE, svg

SIZES_IN = {4: (3.55, 1.9), 12: (2.36, 1.42), 10_000: (2.36, 1.18)}
"""At most how many panels have which width and height, so that more than twelve still fit on one A4 page."""
LONG = 4
"""A unit of more letters does not fit beside the axis."""
SINGLE = 40
POINTS = 100
"""At most this many single cycles are drawn."""
BAND, THIN, STANCE, NORM = "#8fb3d3", "#9a9a9a", "#f1efe9", "#2f7d4f"

LIMBS = ("#b25b00", INK, "#2f7d4f", "#7a3b8f")


def draw_limbs(curves: Curves, panels: list[LimbPanel], unit: str) -> list[Markup]:
    """One SVG element per muscle: the limbs' mean curves over one another, each with its band of one standard deviation."""
    size = next(size for most, size in SIZES_IN.items() if len(panels) <= most)
    with rc_context(STYLE):
        made = []
        for panel in panels:
            figure, axes = _empty_panel(size)
            ends = [0.0]
            for limb, channel, colour in zip(panel.limbs, panel.channels, cycle(LIMBS), strict=False):
                mean, sd = curves.mean[:, channel], np.nan_to_num(curves.sd[:, channel])
                _band(axes, mean, sd, colour, limb)
                ends += [np.nan_to_num(mean + sd).max(), np.nan_to_num(_lower(mean, sd)).min()]
            ends += [end for channel in panel.channels for end in _norm(axes, curves, channel)]
            _finish(axes, figure, ends, unit)
            made.append(svg(figure, f"{panel.name}, {' and '.join(panel.limbs)}"))
        return made


def draw_stages(curves: Curves, names: list[str], stages: list[str], unit: str) -> list[Markup]:
    """One SVG element per channel: the mean curve of each stage."""
    size = next(size for most, size in SIZES_IN.items() if len(names) <= most)
    with rc_context(STYLE):
        made = []
        for i, name in enumerate(names):
            figure, axes = _empty_panel(size)
            for k, stage in enumerate(stages):
                _band(axes, curves.stages[k, :, i], None, COLOURS[k % len(COLOURS)], stage)
            _finish(axes, figure, np.nan_to_num(curves.stages[:, :, i]).ravel().tolist(), unit)
            made.append(svg(figure, f"{name} by stage"))
        return made


def draw_modes(curves: Curves, names: list[str], modes: list[list[list[float]]], unit: str) -> list[Markup]:
    """One SVG element per channel: the mean curve from -50 to 150 % of the cycle, and the modes of its peaks as ellipses of two deviations.

    modes   per channel, each mode's place, height, their deviations, correlation, weight
    """
    size = next(size for most, size in SIZES_IN.items() if len(names) <= most)
    percent = np.arange(-50, 150)
    with rc_context(STYLE):
        made = []
        for i, (name, own) in enumerate(zip(names, modes, strict=True)):
            figure, axes = _empty_panel(size)
            mean, sd = (part[percent % POINTS, i] for part in (curves.mean, np.nan_to_num(curves.sd)))
            axes.fill_between(percent, np.maximum(mean - sd, 0), mean + sd, color=BAND, alpha=0.4, linewidth=0)
            axes.plot(percent, mean, color=INK, linewidth=0.9)
            tops = [float(np.nan_to_num(mean + sd).max(initial=0))]
            for mode in own:
                place, height = _ellipse(*mode[:5])
                tops.append(float(height.max()))
                for turn in (-100, 0, 100):
                    axes.plot(place + turn, height, color=LIMBS[0], linewidth=0.9)
            for cut in (0, 100):
                axes.axvline(cut, color="#777777", linewidth=0.6, linestyle=(0, (3, 2)))
            _finish(axes, figure, tops, unit)
            axes.set_xlim(-50, 150)
            axes.set_xticks([-50, 0, 50, 100, 150])
            made.append(svg(figure, f"{name} modes"))
        return made


def _ellipse(
    place: float, height: float, sd_place: float, sd_height: float, correlation: float
) -> tuple[Samples, Samples]:
    """The points of an ellipse of two standard deviations."""
    turn = np.linspace(0, 2 * np.pi, 49)
    up = correlation * np.cos(turn) + np.sqrt(max(1 - correlation**2, 0.0)) * np.sin(turn)
    return place + 2 * sd_place * np.cos(turn), height + 2 * sd_height * up


def draw_footfalls(footfalls: list[tuple[str, float, float]]) -> Markup:
    """The footfall diagram: when in the stride each limb stands, on the mean."""
    with rc_context(STYLE):
        height = 0.45 + 0.2 * len(footfalls)
        figure = Figure(figsize=(4.6, height))
        axes = figure.add_axes((0.16, 0.38 / height, 0.82, 0.98 - 0.38 / height))
        for k, (_, phase, duty) in enumerate(reversed(footfalls)):
            if np.isfinite(phase) and np.isfinite(duty):
                for begin in (phase - 100, phase):
                    axes.barh(k, duty, left=begin, height=0.6, color=INK)
        axes.set_yticks(range(len(footfalls)), [limb for limb, *_ in reversed(footfalls)])
        axes.set_xlim(0, 100)
        axes.set_xlabel("% of the reference limb's stride")
        return svg(figure, "footfall diagram")


def draw_active(active: Samples, names: list[str]) -> Markup:
    """Bars: a row per muscle, as dark as the share of the cycles in which it was active."""
    shown = [i for i in range(len(names)) if np.isfinite(active[:, i]).any()]
    height = 0.4 + 0.16 * max(len(shown), 1)
    with rc_context(STYLE):
        figure = Figure(figsize=(7.0, height))
        axes = figure.add_axes((0.1, 0.32 / height, 0.88, 0.98 - 0.34 / height))
        for k, i in enumerate(reversed(shown)):
            for start, stop, level in _stretches(active[:, i]):
                axes.barh(k, stop - start, left=start, height=0.7, align="center", color=INK, alpha=level, linewidth=0)
        axes.set_yticks(range(len(shown)), [names[i] for i in reversed(shown)])
        axes.set_xlim(0, 100)
        axes.set_ylim(-0.6, max(len(shown), 1) - 0.4)
        axes.set_xlabel("% of the cycle")
        return svg(figure, "when muscles are active")


def _stretches(share: Samples) -> list[tuple[int, int, float]]:
    """Runs of one shade, in steps of a tenth; those below a twentieth are left white."""
    levels = np.round(np.nan_to_num(share), 1)
    edges = [0, *(np.flatnonzero(np.diff(levels)) + 1).tolist(), len(levels)]
    return [(a, b, float(levels[a])) for a, b in pairwise(edges) if levels[a] > 0]


def _empty_panel(size: tuple[float, float]) -> tuple[Figure, Axes]:
    width, height = size
    figure = Figure(figsize=size)
    return figure, figure.add_axes((0.28 / width, 0.16 / height, 1 - 0.4 / width, 1 - 0.29 / height))


def _band(axes: Axes, mean: Samples, sd: Samples | None, colour: str, label: str) -> None:
    percent = np.arange(len(mean)) * (100 / len(mean))
    if np.isfinite(mean).any():
        if sd is not None:
            axes.fill_between(percent, _lower(mean, sd), mean + sd, color=colour, alpha=0.2, linewidth=0)
        axes.plot(percent, mean, color=colour, linewidth=1.2, label=label)


def _signed(mean: Samples) -> bool:
    """Whether a mean curve goes below 0, as that of an angle or a moment does; an envelope undershoots by less than a twentieth."""
    known = mean[np.isfinite(mean)]
    return bool(len(known)) and bool(known.min() < -0.05 * max(known.max(), 0.0))


def _lower(mean: Samples, sd: Samples) -> Samples:
    """The lower edge of a curve's band, which is not below 0 where the signal never is."""
    return mean - sd if _signed(mean) else np.maximum(mean - sd, 0)


def _norm(axes: Axes, curves: Curves, channel: int) -> tuple[float, float]:
    """The normative band of a channel, behind its curve, where there is one; gives how far down and up it reaches."""
    if not curves.norms.size or np.isnan(curves.norms[:, :, channel]).any():
        return 0.0, 0.0
    low, high = curves.norms[:, :, channel]
    low = low if _signed(curves.mean[:, channel]) else np.maximum(low, 0)
    percent = np.arange(len(low)) * (100 / len(low))
    axes.fill_between(percent, low, high, color=NORM, alpha=0.16, linewidth=0, zorder=0)
    for edge in (low, high):
        axes.plot(percent, edge, color=NORM, linewidth=0.6, linestyle=(0, (4, 2)), zorder=1, gid="norm")
    return float(low.min()), float(high.max())


def _finish(axes: Axes, figure: Figure, ends: list[float], unit: str) -> None:
    """An axis that holds all `ends`, and 0."""
    axes.set_xlim(0, 100)
    axes.set_ylim(1.05 * min([*ends, 0.0]), 1.05 * max([*ends, 1e-9]))
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.locator_params(axis="y", nbins=4)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=False, fontsize=5.5, loc="upper right", handlelength=1.2, borderaxespad=0.1)
    _write_unit(axes, figure, unit)


def draw(curves: Curves, stance_percent: float, unit: str, titles: list[str]) -> list[Markup]:
    """One SVG element per muscle: mean curve, band of one standard deviation, thin single cycles, stance shaded."""
    chosen = curves.single[np.linspace(0, len(curves.single) - 1, min(len(curves.single), SINGLE)).round().astype(int)]
    size = next(size for most, size in SIZES_IN.items() if len(titles) <= most)
    with rc_context(STYLE):
        return [
            _muscle(curves, i, chosen[:, :, i], stance_percent, unit, title, size) for i, title in enumerate(titles)
        ]


def _muscle(
    curves: Curves, channel: int, single: Samples, stance: float, unit: str, title: str, size: tuple[float, float]
) -> Markup:
    width, height = size
    mean, sd = curves.mean[:, channel], curves.sd[:, channel]
    figure = Figure(figsize=size)
    axes = figure.add_axes((0.28 / width, 0.16 / height, 1 - 0.4 / width, 1 - 0.29 / height))
    percent = np.arange(len(mean)) * (100 / len(mean))
    if np.isfinite(stance):
        axes.axvspan(0, stance, color=STANCE, linewidth=0)
        axes.axvline(stance, color="#777777", linewidth=0.6, linestyle=(0, (3, 2)))
    lines = [np.column_stack([percent, curve]) for curve in single if np.isfinite(curve).any()]
    axes.add_collection(LineCollection(lines, colors=THIN, linewidths=0.25, alpha=0.55))
    if np.isfinite(mean).any():
        if np.isfinite(sd).any():
            axes.fill_between(percent, _lower(mean, sd), mean + sd, color=BAND, alpha=0.6, linewidth=0)
        axes.plot(percent, mean, color=INK, linewidth=1.3)
    else:
        axes.text(50, 0.5, "no valid cycle", ha="center", color="#777777", transform=axes.get_xaxis_transform())
    axes.set_xlim(0, 100)
    low, high = _norm(axes, curves, channel)
    top, bottom = max(_top(mean, sd, single), 1.05 * high), 1.05 * low
    if _signed(mean):
        bottom = min(bottom, -_top(-mean, sd, -single))
        axes.axhline(0.0, color="#777777", linewidth=0.4)
        _mark_cut(axes, -single, -bottom, below=True)
    axes.set_ylim(bottom, top)
    _mark_cut(axes, single, top)
    axes.set_xticks([0, 25, 50, 75, 100])
    axes.locator_params(axis="y", nbins=4)
    _write_unit(axes, figure, unit)
    return svg(figure, title)


def _write_unit(axes: Axes, figure: Figure, unit: str) -> None:
    """Above the axis' numbers, in line with them; a long one ("% task peak") begins at the panel's edge, or it would stick out of it."""
    long = len(unit) > LONG
    across = figure.transFigure if long else axes.transAxes
    transform = blended_transform_factory(across, axes.transAxes)
    x, side = (0.0, "left") if long else (-0.02, "right")
    axes.text(x, 1.03, unit, ha=side, va="bottom", color="#55534e", transform=transform)


def _top(mean: Samples, sd: Samples, single: Samples) -> float:
    """The upper end of the axis: the band fits in, a lone wild cycle may run out of the picture."""
    values = np.concatenate([mean + np.nan_to_num(sd), single.max(axis=1) if single.size else np.empty(0)])
    values = values[np.isfinite(values)]
    if not len(values):
        return 1.0
    band = (mean + np.nan_to_num(sd))[np.isfinite(mean)]
    return float(1.05 * max(band.max() if len(band) else 0.0, np.quantile(values, 0.95), 1e-9))


def _mark_cut(axes: Axes, single: Samples, top: float, *, below: bool = False) -> None:
    """Say where the axis ends before a cycle's peak: a mark where it leaves the picture, and how far it goes.

    `below`: at the lower end, with `single` and `top` negated.
    """
    highest = np.nan_to_num(single).max(axis=1) if single.size else np.empty(0)
    over = np.flatnonzero(highest > max(top, 0.0))
    if not len(over):
        return
    at = np.nan_to_num(single[over]).argmax(axis=1) * (100 / single.shape[1])
    sign, mark, word = (-1, "v", "down") if below else (1, "^", "up")
    axes.plot(at, np.full(len(at), sign * top), mark, color="#a3211b", markersize=2.5, clip_on=False)
    axes.text(
        0.99, 0.01 if below else 0.99, f"cut off: {len(over)} {word} to {sign * highest.max():.3g}", ha="right",
        va="bottom" if below else "top", fontsize=5, color="#a3211b", transform=axes.transAxes,
    )  # fmt: skip
