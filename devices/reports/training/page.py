"""The page of a training session: one HTML file that needs nothing else, readable on a screen and on A4 paper."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.reports.training.rows import Exercise, Training, exercises
from kinegraph.stream.chunk import NEVER, NS
from kinegraph.stream.text import report
from kinegraph.stream.text.time_text import elapsed, minute
from kinegraph.stream.text.units import shown

BAR_WIDTH, BARS_HEIGHT = 9, 46
"""Pixels of a repetition's bar, and of the longest one's height."""
COURSE_WIDTH, COURSE_HEIGHT = 760, 44
SCALE = 0.1
"""The height of a course is at least this share of its values, so that an invisible difference looks like 0."""


def _fact(key: str, value: Any) -> tuple[str, str]:
    """A fact of the session, for people."""
    words = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
    return "simulated" if key == "simulated_sources" else key.replace("_", " "), words


def render(
    title: str,
    facts: Mapping[str, Any],
    training: Training,
    unit: str,
    table: str,
    full_share: float,
    min_repetitions: int,
) -> str:
    """The page's HTML. `unit`: of ranges and distances; `table`: the name of the CSV file beside it; `full_share`: as in `exercises`."""
    sets = exercises(training, full_share)
    lasted = (training.ended - training.began) / NS if training.began != NEVER else 0.0
    return report.render(
        Path(__file__).with_name("page.html.j2"),
        title,
        facts=[_fact(key, value) for key, value in facts.items()],
        began="" if training.began == NEVER else minute(training.began),
        sets=sets,
        totals=totals(sets),
        lasted=elapsed(lasted, hours=False),
        repetitions=sum(one.repetitions for one in sets),
        left_out=training.left_out,
        unit=shown(unit),
        table_file=table,
        number=number,
        minutes=partial(elapsed, hours=False),
        bars=bars,
        courses=courses(sets, lasted),
        mean=lambda values: float(np.nanmean(values)) if np.isfinite(values).any() else np.nan,
        partial=any(one.partial for one in sets),
        full_share=f"{100 * full_share:.0f} %",
        min_repetitions=min_repetitions,
        handed=any(one.symmetry for one in sets),
        sided=any(np.isfinite(one.alike) for one in sets),
        doubtful=any(one.doubtful for one in sets),
        questioned=any(one.name.endswith("?") for one in sets),
        shown=any(np.isfinite(one.distances).any() for one in sets),
    )


def totals(sets: list[Exercise]) -> list[tuple[str, int, int]]:
    """By exercise: name, sets, repetitions; in the order of first appearance."""
    names = list(dict.fromkeys(one.name for one in sets))
    return [(n, sum(s.name == n for s in sets), sum(s.repetitions for s in sets if s.name == n)) for n in names]


def bars(values: tuple[float, ...]) -> dict[str, Any]:
    """A bar per repetition, as high as it took long: places and heights, in pixels."""
    most = max([v for v in values if np.isfinite(v)], default=0.0)
    heights = [BARS_HEIGHT * v / most if most > 0.0 and np.isfinite(v) else 0.0 for v in values]
    return {
        "width": max(1, BAR_WIDTH * len(values)),
        "height": BARS_HEIGHT,
        "bars": [(BAR_WIDTH * k, BARS_HEIGHT - h, BAR_WIDTH - 2, h) for k, h in enumerate(heights)],
    }


def courses(sets: list[Exercise], lasted: float) -> list[dict[str, Any]]:
    """By exercise, how the duration, the range and (where it was shown) the distance of its repetitions went over the session.

    Of each the dots' places in pixels, the whole session, `lasted` seconds, wide, and the numbers at the top and at the bottom.
    """
    made = []
    for name in dict.fromkeys(one.name for one in sets):
        mine = [one for one in sets if one.name == name]
        x = [t for one in mine for t in one.starts]
        lines = []
        for what, field in (("duration", "durations"), ("range", "ranges"), ("off", "distances")):
            values = [v for one in mine for v in getattr(one, field)]
            known = [v for v in values if np.isfinite(v)]
            if not known:
                continue
            low, high = min(known), max(known)
            middle = (low + high) / 2.0
            spread = max(high - low, SCALE * abs(middle)) or 1.0
            dots = [
                (
                    4 + (COURSE_WIDTH - 8) * t / lasted if lasted > 0.0 else 4,
                    4 + (COURSE_HEIGHT - 8) * (0.5 - (v - middle) / spread),
                )
                for t, v in zip(x, values, strict=True)
                if np.isfinite(v)
            ]
            lines.append({"what": what, "dots": dots, "low": low, "high": high})
        made.append({"name": name, "lines": lines, "width": COURSE_WIDTH, "height": COURSE_HEIGHT})
    return made


def number(value: float, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"
