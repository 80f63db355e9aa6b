"""A comparison of sessions as one HTML page and as CSV tables."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from markupsafe import Markup

from kinegraph.operators.emg.commands.comparison import Comparison, Scatter, standardised
from kinegraph.operators.emg.commands.comparison_curves import WITH_BANDS, draw_curves
from kinegraph.stream.system.atomic_file import complete, write_complete
from kinegraph.stream.text import report
from kinegraph.stream.text.units import shown


def write_page(found: Comparison, path: Path, title: str) -> None:
    """Write the page; it appears when it is complete. Raises OSError."""
    text = report.render(
        Path(__file__).with_name("comparison.html.j2"), title, sessions=list(zip(found.labels, found.cycles, strict=True)),
        alike=found.alike, unit=shown(str(found.alike["height_unit"] or "")), tables=_tables(found),
        dendrogram=_dendrogram(found), speeds=found.speeds, curves=draw_curves(found), curves_note=_curves_note(found),
    )  # fmt: skip
    write_complete(path, text)


def write_tables(found: Comparison, path: Path) -> None:
    """Every number, a row each: what, muscle, session, other session, value. Raises OSError."""
    rows = list[tuple[object, ...]]()
    for kind, part in (("own mean", found.intra), ("group mean", found.inter)):
        for s in part:
            for name in ("deviation", "mad", "eq_6_9", "eq_6_10"):
                rows.append((f"{name}, {kind}", s.muscle, s.session, "", s.cycles, getattr(s, name)))
    for muscle, table in found.distances.items():
        for i, mine in enumerate(found.labels):
            rows += [
                ("divergence", muscle, mine, theirs, found.cycles[i], table[i, j])
                for j, theirs in enumerate(found.labels)
            ]
        for i, mine in enumerate(found.labels):
            for what, curve in (("mean", found.means[muscle][i]), ("sd", found.sds[muscle][i])):
                rows += [(f"{what} at {p} %", muscle, mine, "", found.cycles[i], v) for p, v in enumerate(curve)]
    for band in found.bands:
        of = band.muscle, *(found.labels[place] for place in band.pair), ""
        rows.append(("smallest relevant difference", *of, band.relevant))
        for p, (difference, width) in enumerate(zip(band.difference, band.width, strict=True)):
            rows.append((f"difference at {p} %", *of, difference))
            rows += [
                (f"its 95 % band at {p} %, {end}", *of, difference + k * width) for end, k in (("low", -1), ("high", 1))
            ]
    with complete(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("what", "muscle", "session", "other", "cycles", "value", "normalisation"))
        writer.writerows((*row, found.alike["normalisation"]) for row in rows)


def _curves_note(found: Comparison) -> str:
    few = max(len(band.group.members) for band in found.bands) <= WITH_BANDS
    bands = "mean of each session, with its standard deviation" if few else "mean of each session"
    return (
        f"Above: {bands}. Below: the second less the first, with a band that holds the whole difference in 95 % of resamplings of cycles "
        f"(bootstrap); dotted: the smallest relevant difference, {found.relevant_pct:g} % of the larger peak (--relevant); shaded: where "
        "the difference exceeds both."
    )


def _tables(found: Comparison) -> list[dict[str, object]]:
    made = [
        _scatter_table(found.intra, "Scatter of a session's cycles about their own mean curve (tables 6.1, 6.2)"),
        _scatter_table(found.inter, "Scatter about the group's mean curve (tables 6.3, 6.4)"),
    ]
    note = "Cauchy-Schwarz divergence of the peaks' mixtures: 0 for the same, no upper bound; 'not known' where a muscle has no burst."
    for muscle, table in found.distances.items():
        rows = [
            [label, modes, *map(_number, row)]
            for label, modes, row in zip(found.labels, found.modes[muscle], table, strict=True)
        ]
        made.append(
            {"title": f"{muscle}: how far apart", "note": note, "head": ["", "modes", *found.labels], "rows": rows}
        )
    made.append(_differences(found))
    return made


def _differences(found: Comparison) -> dict[str, object]:
    unit = shown(str(found.alike["height_unit"] or ""))
    rows = []
    for band in found.bands:
        first, second = (found.labels[place] for place in band.pair)
        largest = float(np.abs(band.difference[band.places]).max()) if band.places else float("nan")
        cells = f"{largest:.3g} {unit}".strip() if band.places else "–", f"{band.relevant:.3g} {unit}".strip()
        rows.append([band.name, f"{second} less {first}", stretches(band.places), *cells])
    note = (
        "Where the mean curves' difference exceeds both its simultaneous 95 % bootstrap band and the smallest relevant difference,"
        f" {found.relevant_pct:g} % of the larger peak (--relevant)."
    )
    head = ["muscle", "compared", "% of the cycle", "largest there", "relevant from"]
    return {"title": "Where mean curves differ", "note": note, "head": head, "rows": rows}


def _scatter_table(part: list[Scatter], title: str) -> dict[str, object]:
    note = (
        "In shares of the muscle's highest value in the session. Deviation and MAD are the mean distance of a cycle and the mean absolute "
        "deviation of the distances, which the thesis's tables hold; eq. 6.9 and 6.10 are as printed."
    )
    rows = [[s.session, s.muscle, s.cycles, *map(_number, (s.deviation, s.mad, s.eq_6_9, s.eq_6_10))] for s in part]
    head = ["session", "muscle", "cycles", "deviation", "MAD", "eq. 6.9", "eq. 6.10"]
    return {"title": title, "note": note, "head": head, "rows": rows}


def stretches(places: list[int]) -> str:
    """Places in % as stretches: "3-9, 41"; "nowhere" if empty."""
    made = list[list[int]]()
    for p in places:
        if made and p == made[-1][1] + 1:
            made[-1][1] = p
        else:
            made.append([p, p])
    return ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in made) or "nowhere"


def _number(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "not known"


def _dendrogram(found: Comparison) -> Markup:
    from matplotlib.figure import Figure
    from scipy.cluster.hierarchy import dendrogram

    figure = Figure(figsize=(8, 1.5 + 0.3 * len(found.labels)), layout="constrained")
    axes = figure.add_subplot()
    linkage = found.linkage.copy()
    if not linkage[:, 2].any():
        linkage[:, 2] = np.finfo(float).eps  # all alike: an axis needs a length
    dendrogram(linkage, labels=found.labels, orientation="right", ax=axes, color_threshold=0.0)
    axes.set_xlabel(f"distance ({standardised(found.features).shape[1]} features)")
    return report.png(figure, "dendrogram")
