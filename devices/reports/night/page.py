"""The morning's report: one HTML file that needs nothing else, one A4 page as PNG, and an EDF+ file.

`python -m devices.reports.night.page FOLDER` draws them in a process of its own, so that no graph waits for matplotlib.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, night_zone, zone_of
from kinegraph.devices.reports.night.edf import write_edf
from kinegraph.devices.reports.night.numbers import (
    CAVEATS,
    KNOWN_ERROR,
    NO_NUMBERS,
    ReportRow,
    begun_after,
    quality,
    span,
    table,
)
from kinegraph.devices.reports.night.summary import headline, sentence, wakings
from kinegraph.stream.chunk import Samples
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import write_complete
from kinegraph.stream.text import report

T = TypeVar("T")


def draw(folder: Path) -> Path:
    """Draw everything a night's folder holds; the page's path.

    Every product is made by itself, so that one which cannot be made takes no other with it; what failed is named in the page.
    Raises NightError, which names what failed and why, once all the others are written.
    """
    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    epochs = epochs.part(*span(facts, epochs))
    if not len(epochs):
        raise archive.NightError(f"{folder} holds no epochs of the night")
    motion = archive.read_map(folder)
    rows = table(facts, epochs)
    page, picture, edf = (folder / name for name in archive.DRAWN)
    failed: dict[str, str] = {}
    _attempt(picture.name, failed, lambda: write_complete(picture, _picture(facts, epochs, motion, rows)))
    _attempt(edf.name, failed, lambda: write_edf(edf, facts, epochs))
    _attempt(page.name, failed, lambda: write_complete(page, render(facts, epochs, motion, rows, failed).encode()))
    if failed:
        why = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        made = ", ".join(path.name for path in (page, picture, edf) if path.name not in failed)
        raise archive.NightError(
            f"not every file of the night {folder.name} could be made: {why} (made: {made or 'nothing'})"
        )
    return page


def _attempt(product: str, failed: dict[str, str], make: Callable[[], T]) -> T | None:
    """Make one product; whatever goes wrong with it is kept in `failed`, and ends nothing else."""
    try:
        return make()
    except Exception as error:  # noqa: BLE001  (a fault of one product, a library's too, must leave the others; it is named)
        failed[product] = str(error) if isinstance(error, KinegraphError) else f"{type(error).__name__}: {error}"
        return None


def render(
    facts: Facts,
    epochs: LoggedEpochs,
    motion: Samples | None,
    rows: list[ReportRow],
    failed: dict[str, str] | None = None,
) -> str:
    """The page's HTML; figures that cannot be drawn are named where they would stand, and added to `failed`."""
    return report.render(
        Path(__file__).with_name("page.html.j2"),
        title(facts),
        f=facts,
        versions=facts.versions,
        sentence=sentence(facts, epochs),
        headline=headline(facts),
        line=line(facts, epochs),
        rows=rows,
        figures=[row for row in rows if row.name.startswith(HEADLINE)],
        quality=quality(facts, epochs),
        wakings=wakings(facts, epochs),
        caveats=CAVEATS,
        known_error=KNOWN_ERROR,
        no_numbers=NO_NUMBERS[facts.closed],
        method=_method(facts),
        **_figures(facts, epochs, motion, {} if failed is None else failed),
        epochs=archive.EPOCHS,
        edf=archive.DRAWN[2],
        failed=failed or {},
    )


def _figures(facts: Facts, epochs: LoggedEpochs, motion: Samples | None, failed: dict[str, str]) -> dict[str, str]:
    """The figures of the page as SVG, each by itself, or ""."""
    from kinegraph.devices.reports.night import figures

    night = _attempt("hypnogram in report.html", failed, lambda: figures.night_svg(facts, epochs))
    where = None if motion is None else _attempt("motion map in report.html", failed, partial(figures.map_svg, motion))
    return {"night": night or "", "map": where or ""}


HEADLINE = ("Total sleep", "Sleep efficiency", "Sleep onset", "Wake after", "Bed exits")


def title(facts: Facts) -> str:
    """Which night it is: the evening's date, as in the folder's name."""
    evening = archive.evening(int(facts.numbers.get("onset", facts.begun)), night_zone(facts))
    owner = f", {facts.sleeper}" if facts.sleeper else ""
    return f"Night of {evening:%A}, {evening.day} {evening:%B %Y}{owner}"


def line(facts: Facts, epochs: LoggedEpochs) -> str:
    """From when to when, by which convention, and whether anyone really slept there."""
    zone, n = night_zone(facts), facts.numbers
    if not n:
        return f"Since {clock(facts.begun, zone):%H:%M}. {NO_NUMBERS[facts.closed]}"
    begin, end = clock(int(n["onset"]), zone), clock(int(n["end"]), zone)
    by = {"lights": "lights off and on", "schedule": "the schedule"}.get(
        n.get("bed", ""), "time in bed, as it was seen"
    )
    made_up = "  ·  simulated" if facts.session.get("simulated_sources") or facts.meta.get("simulated") else ""
    since = f", of a night that began at {clock(facts.begun, zone):%H:%M}" if begun_after(facts, epochs) else ""
    new = clock(int(n["end"]), zone_of(facts.timezone))
    changed = (
        f" (the clocks changed that night: by the new time ({new:%Z}) it ended at {new:%H:%M})"
        if new.utcoffset() != end.utcoffset()
        else ""
    )
    return f"{begin:%H:%M} to {end:%H:%M} {end:%Z}{changed}{since}  ·  by {by}  ·  numbers by the definitions of {n['convention']}{made_up}"


def _method(facts: Facts) -> str:
    meta = facts.meta
    names = {"thesis": "Gaussian-weighted share of epochs with movement (Patterns in Motion, 4.3)"}
    lines = [names.get(str(meta.get("method")), str(meta.get("method", "")).replace("_", " "))]
    if meta.get("threshold") is not None:
        lines.append(
            f"wake from {meta['threshold']:g} on"
            if meta.get("method") == "thesis"
            else f"threshold {meta['threshold']:g}"
        )
    lines.append("with Webster's rescoring" if meta.get("rescored") else "no rescoring")
    if meta.get("calibration"):
        lines.append(f"calibration {meta['calibration']}")
    return ", ".join(lines)


def _picture(facts: Facts, epochs: LoggedEpochs, motion: Samples | None, rows: list[ReportRow]) -> bytes:
    from kinegraph.devices.reports.night import figures

    return figures.page_png(facts, epochs, motion, rows, quality(facts, epochs), title(facts), line(facts, epochs))


def one_page(folder: Path) -> bytes:
    """The night on one page, as PDF. Raises NightError."""
    from kinegraph.devices.reports.night import figures

    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    rows, seen = table(facts, epochs), quality(facts, epochs)
    return figures.page_png(
        facts, epochs, archive.read_map(folder), rows, seen, title(facts), line(facts, epochs), "pdf"
    )


def main() -> None:
    try:
        draw(Path(sys.argv[1]))
    except (OSError, KinegraphError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
