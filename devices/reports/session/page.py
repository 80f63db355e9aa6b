"""The page of a report: one HTML file that needs nothing else, readable on a screen and on A4 paper.

`python -m devices.reports.session.page DATA PAGE` draws it in a process of its own, so that no graph waits for matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.reports.session.contents.data import Curves, Muscle, Report, ReportValue, Stream, load
from kinegraph.devices.reports.session.contents.labels import normalisation_text
from kinegraph.stream.chunk import NS
from kinegraph.stream.system.atomic_file import write_complete
from kinegraph.stream.text import report as pages
from kinegraph.stream.text.time_text import elapsed, time_of_day
from kinegraph.stream.text.units import shown

AT_TIMES = 0.1
"""From this share of bad windows on, a channel that is good on the whole is named."""
WATCHES = {
    "patterns": "Swapped leads and changes of a muscle's size or rest were not watched for: that takes {} cycles of a limb.",
    "timing": "Contacts that come later or earlier than at first were not watched for: that takes {} cycles of a limb.",
    "changes": "Slow changes of a muscle's activity were not watched for: that takes {} cycles of a limb.",
}
"""What is not known of a session with fewer cycles, by the report's input."""
MARKS = {"good": "✓ good", "doubtful": "! doubtful", "bad": "✗ bad"}


def write(page: Path, report: Report, curves: Curves) -> None:
    """Draw the page, whole or not at all. Raises OSError."""
    write_complete(page, render(report, curves))


def render(report: Report, curves: Curves) -> str:
    """The page's HTML."""
    from kinegraph.devices.reports.session import curves as report_curves

    stance = report.stance_percent
    return pages.render(
        Path(__file__).with_name("page.html.j2"),
        report.title,
        versions=report.versions,
        r=report,
        unit=shown(report.unit),
        shown=shown,
        lost=_lost,
        columns=3 if len(report.muscles) > 4 else 2,
        judged=any(m.verdict for m in report.muscles),
        drawn=_shown(report, curves),
        stage_svgs=report_curves.draw_stages(
            curves, [m.name for m in report.muscles], report.stages, shown(report.unit)
        )
        if report.stages
        else [],
        active_svg=report_curves.draw_active(curves.active, [m.name for m in report.muscles])
        if any(grid.title == "Bursts" for grid in report.grids) and curves.active.size
        else "",
        mode_svgs=report_curves.draw_modes(curves, [m.name for m in report.muscles], report.modes, shown(report.unit))
        if report.modes
        else [],
        footfall_svg=report_curves.draw_footfalls(report.footfalls) if report.footfalls else "",
        figures=_figures(report),
        marks=MARKS,
        quality=quality_sentence(report.muscles),
        all_good=all(m.verdict == "good" and m.troubled < AT_TIMES for m in report.muscles),
        normalisation=normalisation_text(report.normalisation),
        side=_side(report),
        stance=f"{stance:.1f}" if np.isfinite(stance) else "",
        single=min(len(curves.single), report_curves.SINGLE),
        limits=limits(report),
        ended=time_of_day(report.ended),
        cell=_cell,
        number=_number,
        thousands=lambda n: f"{n:,}".replace(",", " "),
    )


def _shown(report: Report, curves: Curves) -> list[dict[str, Any]]:
    """The panels: name, site, verdicts and drawing of each muscle, or of each muscle of several limbs."""
    from kinegraph.devices.reports.session import curves as report_curves

    muscles, unit = report.muscles, shown(report.unit)
    if report.panels:
        svgs = report_curves.draw_limbs(curves, report.panels, unit)
        return [
            {
                "name": panel.name,
                "site": "",
                "flags": [
                    (muscles[i].verdict, f"{limb} {MARKS[muscles[i].verdict]}")
                    for limb, i in zip(panel.limbs, panel.channels, strict=True)
                    if muscles[i].verdict
                ],
                "svg": svg,
            }
            for panel, svg in zip(report.panels, svgs, strict=True)
        ]
    svgs = report_curves.draw(curves, report.stance_percent, unit, [m.name for m in muscles])
    return [
        {"name": m.name, "site": m.site, "flags": [(m.verdict, MARKS[m.verdict])] if m.verdict else [], "svg": svg}
        for m, svg in zip(muscles, svgs, strict=True)
    ]


def quality_sentence(muscles: list[Muscle]) -> str:
    """Which channels can be used, in a sentence or two."""
    judged = [m for m in muscles if m.verdict]
    if not judged:
        return "Not judged in this session: look at the single cycles before using a curve."
    bad = [f"{m.name} {m.verdict}{_because(m)}" for m in judged if m.verdict != "good"]
    at_times = [f"{m.name}{_because(m)}" for m in judged if m.verdict == "good" and m.troubled >= AT_TIMES]
    good = (
        f"All {len(judged)} channels are good"
        if not bad
        else f"{len(judged) - len(bad)} of {len(judged)} channels are good"
    )
    lines = [
        f"{good}.",
        f"Look at: {'; '.join(bad)}." if bad else "",
        f"At times not good: {'; '.join(at_times)}." if at_times else "",
    ]
    return " ".join(part for part in lines if part)


def _because(muscle: Muscle) -> str:
    return f" ({muscle.remark})" if muscle.remark else ""


def limits(report: Report) -> list[str]:
    """What a reader must know before drawing conclusions."""
    rows = []
    if not report.accepted:
        rows.append("No cycle was accepted, so this page says nothing of the muscles; only the signals were judged.")
    elif report.accepted < 10:
        rows.append(
            f"Only {report.accepted} cycles were accepted. Means and standard deviations of so few are uncertain; the variance ratio"
            " is given from ten cycles on."
        )
    if report.unnamed:
        rows.append(
            f"Unchecked: whether electrodes of {', '.join(report.unnamed)} were on another muscle from the start, since their names are no"
            " muscle with known activity in walking (`muscles` of TimingWatch says which it is)."
        )
    rows += [WATCHES[port].format(n) for port, n in report.unjudged if port in WATCHES]
    if report.envelopes and report.normalisation in ("", "none"):
        rows.append(
            "Amplitudes are not normalised. They depend on electrodes, skin and their exact place: compare shapes and times between people"
            " and sessions, not sizes, and do not compare sizes between muscles."
        )
    if report.envelopes:
        rows.append(
            "Surface electrodes also pick up neighbouring muscles (cross-talk), most of all over thin or deep ones. An envelope shows when"
            " a muscle's region was electrically active; it is not a force."
        )
    return [
        *rows,
        "A high variance ratio or coefficient of variation alone says that the cycles are not alike. It does not say why: a loose"
        " electrode and a changing gait look the same there. The signal verdict judges the electrode, from clipping, flat line, mains hum,"
        " baseline noise and artefacts.",
        "Cycles are cut at the contacts that were detected. A contact found late shifts and stretches every curve of its cycle.",
        "Norm values depend on speed, age, electrodes and filters, and hold for the laboratory that made them."
        if any(grid.title == "Beside the normative bands" for grid in report.grids)
        else "No norm values are shown: those depend on speed, age, electrodes and filters, and hold for the laboratory that made them.",
    ]


def _figures(report: Report) -> list[dict[str, str]]:
    figures = [{"text": str(report.accepted), "spread": "", "label": f"cycles ({report.rejected} rejected)"}]
    for value in report.gait:
        spread = f"{value.spread:z.{value.decimals}f}" if np.isfinite(value.spread) else ""
        text = f"{value.value:z.{value.decimals}f}" if np.isfinite(value.value) else "–"
        figures.append(
            {"text": text, "spread": spread, "label": f"{value.label} ({value.unit})" if value.unit else value.label}
        )
    lasted = elapsed(round(max(0, report.ended - report.started) / NS), hours=False)
    figures.append({"text": lasted, "spread": "", "label": "session (min:s)"})
    return figures


def _side(report: Report) -> str:
    side = dict(report.facts).get("Side", "")
    return f" of the {side} leg" if side in ("left", "right") else ""


def _lost(stream: Stream) -> str:
    if stream.lost < 0:
        return "some, not known how many"
    whole = stream.samples + stream.lost
    return f"{stream.lost} ({100 * stream.lost / whole:.2f} %)" if stream.lost else "0"


def _number(value: ReportValue) -> str:
    if not np.isfinite(value.value):
        return "–"
    spread = f" ± {value.spread:z.{value.decimals}f}" if np.isfinite(value.spread) else ""
    return f"{value.value:z.{value.decimals}f}{spread}{f' {value.unit}' if value.unit else ''}"


def _cell(value: tuple[float, float], decimals: int) -> Any:
    from markupsafe import Markup

    number, spread = value
    if not np.isfinite(number):
        return "–"
    return Markup(
        f"{number:z.{decimals}f}" + (f" <small>± {spread:z.{decimals}f}</small>" if np.isfinite(spread) else "")
    )


def main() -> None:
    data, page = sys.argv[1:]
    write(Path(page), *load(Path(data)))


if __name__ == "__main__":
    main()
