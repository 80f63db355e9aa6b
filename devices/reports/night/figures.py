"""A night on paper: hypnogram, activity, breathing, and where in the bed it moved."""

from __future__ import annotations

import io
from datetime import timedelta
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.dates import AutoDateLocator, DateFormatter
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, night_zone
from kinegraph.devices.reports.night.numbers import CAVEATS, NO_NUMBERS, ReportRow, exits, runs, span, unseen
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.text import report

INK, SLEEP, WAKE, OUT, GONE, DOT = report.INK, "#2f6690", "#d98a29", "#7a7a7a", "#e3e0d9", "#2f7d4f"
LEVELS = {"out": 2.0, "wake": 1.0, "sleep": 0.0}
A4_IN = (8.27, 11.69)
LOWEST = 0.094
"""Below this, as a share of the page's height, stand the words that belong to every report."""
STYLE: dict[Any, Any] = {
    **report.STYLE,
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "hatch.linewidth": 0.4,
}


def night_svg(facts: Facts, epochs: LoggedEpochs) -> str:
    """Hypnogram, activity and breathing over the clock, as one SVG element."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.0))
        _three(figure, facts, epochs, (0.09, 0.06, 0.88, 0.89))
        return report.svg(figure, "Hypnogram, activity and breathing over the night")


def map_svg(motion: Samples) -> str:
    """The night's motion map, as one SVG element."""
    with rc_context(STYLE):
        width, across = 0.8, 2.8  # as wide as on the page, so that its numbers are as large as they say
        figure = Figure(figsize=(across, across * width * motion.shape[0] / motion.shape[1] + 0.1))
        _map(figure, figure.add_axes((0.0, 0.02, width, 0.96)), motion)
        return report.svg(figure, "Where in the picture it moved during the night")


def page_png(
    facts: Facts,
    epochs: LoggedEpochs,
    motion: Samples | None,
    rows: list[ReportRow],
    seen: list[tuple[str, str]],
    title: str,
    line: str,
    form: str = "png",
) -> bytes:
    """One A4 page: the pictures, the table, and the words that belong to it."""
    with rc_context(STYLE):
        figure = Figure(figsize=A4_IN, facecolor="white")
        figure.text(0.07, 0.962, title, fontsize=15, weight="bold", va="top")
        figure.text(0.07, 0.938, line, fontsize=8.5 * min(1.0, 112 / len(line)), color="#55534e", va="top")
        _three(figure, facts, epochs, (0.115, 0.53, 0.825, 0.375))
        _table(figure, rows, 0.475, NO_NUMBERS[facts.closed])
        if motion is not None:
            figure.text(0.66, 0.475, "Where it moved", fontsize=9, weight="bold", color=INK, va="top")
            axes = figure.add_axes((0.655, 0.322, 0.235, 0.133))
            axes.set_anchor("N")
            _map(figure, axes, motion)
        _beside(figure, seen, 0.305 if motion is not None else 0.475)
        figure.text(0.07, 0.03, "\n".join(CAVEATS), fontsize=7, color="#44423d", va="bottom", linespacing=1.5)
        file = io.BytesIO()
        figure.savefig(file, format=form, dpi=150, metadata={"Creator" if form == "pdf" else "Software": "kinegraph"})
        return file.getvalue()


def _three(figure: Figure, facts: Facts, epochs: LoggedEpochs, place: tuple[float, float, float, float]) -> None:
    """The three panels that share the clock."""
    left, bottom, width, height = place
    breathes = bool(np.isfinite(epochs.numbers["breaths_per_min"]).any())
    shares = (0.38, 0.27, 0.27) if breathes else (0.5, 0.42)
    gap, top = 0.04 * height, bottom + height
    panels: list[Axes] = []
    for share in shares:
        top -= share * height
        panels.append(figure.add_axes((left, top, width, share * height), sharex=panels[0] if panels else None))
        top -= gap
    x = days(epochs.onset, facts), days(epochs.end, facts)
    _hypnogram(panels[0], facts, epochs, x)
    _activity(panels[1], facts, epochs, x)
    if breathes:
        _breathing(panels[2], epochs, x)
    begin, end = days(np.array(span(facts, epochs)), facts)
    for panel in panels:
        panel.set_xlim(begin, end)
        panel.tick_params(labelbottom=panel is panels[-1])
        _unseen(panel, facts, epochs)
    panels[-1].xaxis.set_major_locator(AutoDateLocator(minticks=5, maxticks=11))  # type: ignore[no-untyped-call]
    panels[-1].xaxis.set_major_formatter(DateFormatter("%H:%M"))  # type: ignore[no-untyped-call]


def _hypnogram(axes: Axes, facts: Facts, epochs: LoggedEpochs, x: tuple[Array, Array]) -> None:
    state = np.array([LEVELS.get(s, np.nan) for s in epochs.texts["state"]])
    state[epochs.texts["bed"] == "out"] = LEVELS["out"]
    begin, end = x
    for name, colour in (("sleep", SLEEP), ("wake", WAKE), ("out", OUT)):
        for a, b in runs(state == LEVELS[name]):
            axes.fill_between([begin[a], end[b - 1]], -0.45, LEVELS[name], color=colour, alpha=0.22, linewidth=0)
            axes.plot([begin[a], end[b - 1]], [LEVELS[name]] * 2, color=colour, linewidth=2.4, solid_capstyle="butt")
    for k in np.flatnonzero(np.isfinite(state[1:]) & np.isfinite(state[:-1]) & (state[1:] != state[:-1])):
        axes.plot([begin[k + 1]] * 2, [state[k], state[k + 1]], color=INK, linewidth=0.5)
    axes.set_ylim(-0.45, 2.75)
    axes.set_yticks(list(LEVELS.values()), ["Out of bed", "Wake", "Sleep"])
    n = facts.numbers
    if n:
        names = ("in bed", "out of bed") if n["estimated"] else ("lights off", "lights on")
        for name, key, side in ((names[0], "onset", "left"), (names[1], "end", "right")):
            at = days(np.array([n[key]]), facts)[0]
            axes.axvline(at, color=INK, linewidth=0.7, linestyle=(0, (4, 2)))
            text = f"{name} {clock(int(n[key]), night_zone(facts)):%H:%M}"
            axes.annotate(
                text,
                (at, 2.72),
                (3 if side == "left" else -3, 0),
                textcoords="offset points",
                ha=side,
                va="top",
                color=INK,
            )
    handles = [Patch(facecolor=GONE, hatch="////", edgecolor="#9a978f", label="not scored")]
    if unseen(epochs):
        axes.legend(
            handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, borderpad=0, handlelength=1.6
        )
    for stretch in exits(facts):
        at = days(np.array([stretch.begin]), facts)[0]
        axes.plot([at], [2.0], marker=7, color=INK, markersize=4, linewidth=0)


def _activity(axes: Axes, facts: Facts, epochs: LoggedEpochs, x: tuple[Array, Array]) -> None:
    activity = epochs.numbers["activity"]
    out = epochs.texts["bed"] == "out"
    height = np.where(out, 0.0, np.nan_to_num(activity))
    axes.fill_between(np.column_stack(x).ravel(), 0, np.repeat(height, 2), color=INK, linewidth=0)
    for a, b in runs(out):
        axes.axvspan(x[0][a], x[1][b - 1], color=OUT, alpha=0.22, linewidth=0)
    counts = np.nanmax(activity, initial=0.0) > 1.0
    axes.set_ylabel("Counts\nper epoch" if counts else "Share of the\nepoch in motion")
    axes.set_ylim(0, None if counts else 1.0)


def _breathing(axes: Axes, epochs: LoggedEpochs, x: tuple[Array, Array]) -> None:
    rate, confidence = epochs.numbers["breaths_per_min"], epochs.numbers["confidence"]
    known = np.isfinite(rate)
    middle = (x[0] + x[1]) / 2
    alpha = np.clip(np.nan_to_num(confidence[known], nan=0.5), 0.15, 1.0)
    axes.scatter(middle[known], rate[known], s=3, c=DOT, alpha=alpha, linewidths=0, rasterized=True)  # type: ignore[arg-type]
    low, high = np.percentile(rate[known], [1, 99])
    axes.set_ylim(max(0.0, np.floor(low - 2)), np.ceil(high + 2))
    axes.set_ylabel("Breaths\nper minute")


def _unseen(axes: Axes, facts: Facts, epochs: LoggedEpochs) -> None:
    for stretch in unseen(epochs):
        begin, end = days(np.array([stretch.begin, stretch.end]), facts)
        axes.axvspan(begin, end, facecolor=GONE, edgecolor="#9a978f", hatch="////", linewidth=0, zorder=0)


def _map(figure: Figure, axes: Axes, motion: Samples) -> None:
    seen = np.isfinite(motion)
    if not (motion[seen] > 0).any():
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no motion was seen", ha="center", va="center", transform=axes.transAxes)
        return
    norm = Normalize(0.0, float(np.percentile(motion[seen], 99.8)), clip=True)
    shown = np.ma.masked_invalid(motion)
    axes.set_facecolor(GONE)
    image = axes.imshow(shown, cmap="magma", norm=norm, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    box = axes.get_position()
    bar = figure.colorbar(
        image, cax=figure.add_axes((box.x1 + 0.012, box.y0 + 0.1 * box.height, 0.014, 0.8 * box.height))
    )
    bar.set_label("mm", fontsize=6.5)
    bar.ax.tick_params(labelsize=6)
    bar.outline.set_linewidth(0.4)


def _table(figure: Figure, rows: list[ReportRow], top: float, nothing: str) -> None:
    figure.text(0.07, top, "The night in numbers", fontsize=9, weight="bold", color=INK, va="top")
    y = top - 0.026
    if not rows:
        figure.text(0.07, y, nothing, fontsize=8, va="top")
    step = min(0.0305, (y - 0.1) / max(1, len(rows)))
    for row in rows:
        figure.text(0.07, y, row.name, fontsize=8, va="top")
        figure.text(0.405, y, row.value, fontsize=8, va="top", weight="bold", ha="right")
        figure.text(0.42, y, f"({row.bounds})" if row.bounds else "", fontsize=7, va="top", color="#55534e")
        figure.text(0.07, y - 0.0125, row.meaning, fontsize=6.5, va="top", color="#6a6862")
        y -= step


def _beside(figure: Figure, seen: list[tuple[str, str]], top: float) -> None:
    """What was seen of the night, in the column beside the table; what does not fit above the page's last lines is in the HTML."""
    figure.text(0.66, top, "What was seen", fontsize=9, weight="bold", color=INK, va="top")
    y = top - 0.024
    for name, value in seen:
        lines = wrap(value, 48, max_lines=3, placeholder=" …")
        if y - 0.0115 - 0.0096 * len(lines) < LOWEST:
            figure.text(0.66, y, "…", fontsize=7.5, va="top")
            return
        figure.text(0.66, y, name, fontsize=7.5, va="top")
        figure.text(0.66, y - 0.0115, "\n".join(lines), fontsize=6.5, va="top", color="#6a6862", linespacing=1.25)
        y -= 0.0165 + 0.0096 * len(lines)


def days(time: Array, facts: Facts) -> Array:
    """Times as matplotlib counts days, on the wall clock of the night's beginning (so that no hour is drawn twice)."""
    shift = night_zone(facts).utcoffset(None) or timedelta()
    return (np.asarray(time, np.int64) + int(shift.total_seconds()) * NS) / (86_400 * NS)
