"""Agreement on paper: Bland-Altman plots of the nights' numbers, and every night's two hypnograms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kinegraph.operators.sleep.evaluation.agreement import Limits
from kinegraph.operators.sleep.evaluation.comparison import NOTE, NUMBERS, Pair, agreement
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_NIGHTS = 20
INK, BAND, COLOURS = "#12395b", "#dfe6ee", {SLEEP: "#8fb3d3", WAKE: "#d98a29"}
PEOPLE = ("#12395b", "#d98a29", "#2f7d4f", "#a3211b", "#6b4c9a", "#4d8b8b", "#8a6d3b", "#555555")
STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}


def draw(pairs: list[Pair]) -> Figure:
    """A4: the differences of TST, SOL and WASO against their means, and below them at most 20 nights, epoch by epoch."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    shown, found = pairs[:MAX_NIGHTS], agreement(pairs)
    with rc_context(STYLE):
        figure = Figure(figsize=(8.27, 4.1 + 0.42 * len(shown)), layout="constrained")
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[2.9, 0.7 + 0.42 * len(shown)])[:, 0]
        places = above.subplots(1, len(found))
        for axes, (key, limits) in zip(np.atleast_1d(places), found.items(), strict=True):
            _differences(axes, pairs, key, limits, NUMBERS[key])
        rows = below.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axes, one in zip(rows, shown, strict=True):
            _night(axes, one)
        rows[-1].set_xlabel("hours since the reference began")
        rows[-1].spines["bottom"].set_visible(True)
        rows[-1].tick_params(bottom=True)
        _legend(below)
        more = f" The first {len(shown)} of {len(pairs)} nights are drawn." if len(pairs) > len(shown) else ""
        figure.suptitle(f"{NOTE}{more}", fontsize=7, color="#55534e")
        return figure


def _differences(axes: Axes, pairs: list[Pair], key: str, limits: Limits, name: str) -> None:
    """One number: estimate less reference against the mean of both, a colour per person; bias and limits with their intervals."""
    e, r = (np.array([getattr(getattr(one, side), key) for one in pairs], np.float64) for side in ("found", "truth"))
    people = list(dict.fromkeys(one.person for one in pairs))
    mean = (e + r) / 2
    for number, person in enumerate(people):
        mine = np.array([one.person == person for one in pairs])
        axes.scatter(mean[mine], (e - r)[mine], s=16, color=PEOPLE[number % len(PEOPLE)], linewidths=0, zorder=3)
    low, high = _range(mean)
    axes.set_xlim(low, high + 0.55 * (high - low))
    for value, interval, style, label, place in (
        (limits.high, limits.high_interval, (0, (4, 2)), "upper limit", 0.10),
        (limits.bias, limits.bias_interval, "-", "bias", 0.06),
        (limits.low, limits.low_interval, (0, (4, 2)), "lower limit", 0.02),
    ):
        if not np.isfinite(value):
            continue
        axes.axhline(value, color=INK, linewidth=0.9, linestyle=style)
        text = f"{label} {value:.0f}".replace("-", "−")
        axes.annotate(text, (1, value), (0, 2), xycoords=("axes fraction", "data"), textcoords="offset points",
                      ha="right", fontsize=6.5, color=INK)  # fmt: skip
        if np.isfinite(interval[0]):
            axes.errorbar([high + place * (high - low)], [value], [[value - interval[0]], [interval[1] - value]], color=INK,
                          linewidth=0.8, capsize=2.5, capthick=0.8)  # fmt: skip
    axes.axhline(0.0, color="#9a978f", linewidth=0.5)
    axes.set(title=name, xlabel="mean of both (min)", ylabel="estimate − reference (min)")
    axes.title.set_fontweight("bold")


def _night(axes: Axes, one: Pair) -> None:
    """Reference above, estimate below; wake stands out, what one side does not know is white."""
    hours = (one.time - one.time[0]) / (3600 * NS)
    length = hours[1] - hours[0] if len(hours) > 1 else 1 / 120
    for states, base in ((one.reference, 1.05), (one.estimate, 0.0)):
        for state, height in ((SLEEP, 0.35), (WAKE, 0.9)):
            edges = np.flatnonzero(np.diff(np.r_[False, states == state, False].astype(np.int8))).reshape(-1, 2)
            spans = [(hours[a], (b - a) * length) for a, b in edges]
            axes.broken_barh(spans, (base, height), facecolors=COLOURS[state], linewidth=0)
    c = one.confusion
    unknown = int(((one.reference == UNKNOWN) | (one.estimate == UNKNOWN)).sum())
    kappa = f"κ {c.kappa:.2f}" if np.isfinite(c.kappa) else ""
    axes.annotate(
        f"{kappa}{f', {unknown} unknown' if unknown else ''}",
        (1.005, 0.5),
        xycoords="axes fraction",
        va="center",
        fontsize=6.5,
    )
    axes.set_yticks([0.45, 1.5], ["est.", "ref."], fontsize=6)
    axes.set_ylabel(
        f"{one.name}\n{one.person}" if one.person != one.name else one.name,
        rotation=0,
        ha="right",
        va="center",
        fontsize=7,
    )
    axes.set(ylim=(0, 2.0), xlim=(0, None))
    axes.tick_params(left=False, bottom=False)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)


def _legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(facecolor=COLOURS[WAKE], label="wake"), Patch(facecolor=COLOURS[SLEEP], label="sleep")]
    figure.legend(handles=handles, loc="outside upper right", ncols=2, frameon=False, fontsize=7)


def _range(values: Samples) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin
