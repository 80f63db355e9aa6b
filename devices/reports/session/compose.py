"""From the tally to the contents of the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinegraph.devices.reports.session.contents import labels
from kinegraph.devices.reports.session.contents.data import (
    Curves,
    Muscle,
    Noticed,
    Rejected,
    Report,
    ReportValue,
    Stream,
)
from kinegraph.devices.reports.session.contents.grids import accepted_of, fill_groups
from kinegraph.devices.reports.session.contents.tally import ALARM_PORTS, Tally, most_common, numbers
from kinegraph.stream.chunk import NS, Samples, Specs
from kinegraph.stream.graph import Graph

OVERALL = ("cv_pct", "variance_ratio")
"""What the table takes of the numbers over all cycles; the others say the same as those per cycle."""

MUCH_PCT = 10.0
"""A mean that contacts change by more is marked."""
A_DATE = 366 * 86_400 * NS
"""A recording that says no date (an import without `--start`) counts its time from 1970."""


def compose(tally: Tally, specs: Specs, graph: Graph | None, names: Mapping[str, str]) -> tuple[Report, Curves]:
    """Everything but the title and the files' names. `names` are the streams' names, by port."""
    cycles = specs["cycles"]
    session: Mapping[str, Any] = graph.session if graph else {}
    centre, spread = tally.gait.centre(), tally.gait.spread()
    normalisation = labels.normalisation(cycles.meta)
    steps = max(2, len(cycles.meta.get("limbs") or ()))
    report = Report(
        title="",
        unit=cycles.units[0] if len(cycles.units) == 1 else "",
        normalisation=normalisation,
        started=max(tally.started, 0),
        ended=max(tally.ended, 0),
        facts=[
            *_facts(tally, specs, session),
            *labels.recording(graph),
            *(("Finding", text) for text in (graph.findings if graph else ())),
        ],
        accepted=tally.accepted,
        rejected=tally.rejected,
        reasons=[(_reason(reason), n) for reason, n in most_common(tally)],
        rejections=_rejections(tally),
        alarms=_alarms(tally),
        alarmed=tally.alarmed,
        gait=[
            ReportValue("cadence", float(centre[0]), "strides/min", float(spread[0])),
            ReportValue("cadence", steps * float(centre[0]), "steps/min", steps * float(spread[0])),
            ReportValue("cycle", float(centre[1]), "s", float(spread[1]), 3),
            ReportValue("stance", float(centre[2]), "%", float(spread[2])),
        ],
        pairs=[ReportValue(name, value, "%") for name, value in zip(tally.pair_names, tally.pairs, strict=True)],
        pairs_note=labels.PAIRS.format(normalisation=normalisation) if tally.pairs else "",
        streams=_streams(tally, specs, names),
        settings=list(labels.settings(graph)) if graph else [],
        versions=labels.versions(),
        graph=graph.text.strip() if graph else "",
        stance_percent=float(centre[2]),
        envelopes="envelope" in cycles.meta or str(cycles.units[0]) in ("V", "mV", "uV"),
    )
    report.hanging, report.contact_ms = _hanging(tally, specs)
    report.unjudged = _unjudged(tally, specs)
    report.unnamed = list(specs["timing"].meta.get("unnamed", ())) if "timing" in specs else []
    _fill_table(report, tally, specs, labels.sites(session, cycles.meta))
    fill_groups(report, tally, specs)
    groups = tally.groups
    by_stage = np.array([curve.centre() for curve in groups.stage_curves]).reshape(-1, *tally.curve.mean.shape)
    return report, Curves(
        tally.curve.centre(),
        tally.curve.spread(),
        np.asarray(tally.single.chosen(), np.float64),
        groups.active,
        by_stage,
        tally.norms if "low" in specs and "high" in specs else np.zeros((0, 0, 0)),
    )


def _facts(tally: Tally, specs: Specs, session: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows = list(labels.facts(session))
    if tally.started > A_DATE:
        begun = str(np.datetime64(tally.started, "ns").astype("datetime64[s]"))
        rows.append(("Begun", f"{begun.replace('T', ' ')} UTC"))
    meta = specs["cycles"].meta
    if meta.get("side") and "Side" not in dict(rows):
        rows.append(("Side", str(meta["side"])))
    if meta.get("simulated"):
        rows.append(("Signal", "simulated"))
    return rows


def _rejections(tally: Tally) -> list[Rejected]:
    return [
        Rejected((int(row["onset"]) - tally.started) / NS, float(row["duration_s"]), _reason(str(row["reason"])))
        for row in tally.rejections[: tally.rejected]
    ]


def _alarms(tally: Tally) -> list[Noticed]:
    return [
        Noticed(
            (int(row["onset"]) - tally.started) / NS,
            (int(row["over"]) - int(row["onset"])) / NS if row["over"] else float("nan"),
            str(row["subject"]),
            str(row["what"]),
        )
        for row in tally.alarms[: tally.alarmed]
    ]


def _hanging(tally: Tally, specs: Specs) -> tuple[list[tuple[str, float]], float]:
    """Muscles with means in stance and swing that contacts which are off would change by much, and by how much (%); how far off (ms)."""
    statistics = specs.get("statistics")
    if "contact_pct" not in numbers(statistics) or statistics is None or labels.is_angle(statistics):
        return [], 0.0
    percent = tally.fields[numbers(statistics).index("contact_pct")].centre()
    much = [(name, float(p)) for name, p in zip(specs["cycles"].channels, percent, strict=True) if p > MUCH_PCT]
    return much, 1000 * float(statistics.meta.get("contact_s", 0.0))


def _unjudged(tally: Tally, specs: Specs) -> list[tuple[str, int]]:
    """Watches that compare with first cycles, of which there were too few: the input, and how many cycles it needs of a limb."""
    limbs = [int(gait.n.max(initial=0)) for gait in tally.groups.limb_gait] or [tally.accepted]
    needs = {port: int(specs[port].meta.get("needs_cycles", 0)) for port in ALARM_PORTS if port in specs}
    return [(port, n) for port, n in needs.items() if min(limbs) < n]


def _reason(reason: str) -> str:
    return labels.REASONS.get(reason, reason)


def _streams(tally: Tally, specs: Specs, names: Mapping[str, str]) -> list[Stream]:
    """The raw signal; where it is not connected, the cycles."""
    rows = []
    for port, (n, gaps, lost) in zip(specs, tally.heard, strict=True):
        if port == "emg" or (port == "cycles" and "emg" not in specs):
            spec = specs[port]
            rate = f" at {spec.rate_hz:g} Hz" if spec.rate_hz else ""
            what = f"{len(spec.channels)} muscles{rate}, {spec.units[0]}"
            rows.append(Stream(names.get(port, port), what, int(n), int(gaps), int(lost)))
    return rows


def _remark(tally: Tally, specs: Specs, i: int) -> str:
    """Remarks on a muscle's signal: the electrode, how often it was not good, and the likeness of its cycles."""
    judged, troubled = (int(n) for n in tally.windows[:, i])
    electrode = tally.remarks[i] or tally.trouble[i]
    often = f"{f'{electrode}, ' if electrode else ''}{troubled} of {judged} windows not good" if troubled else electrode
    cycles = accepted_of(tally, specs, i)
    missing = cycles - int(tally.curve.n[0, i])
    left = f"left out of {missing} of {cycles} cycles" if missing > 0 else ""
    return "; ".join(
        part for part in (often, left, tally.repeatable[i] if tally.repeatable[i] != "repeatable" else "") if part
    )


def _troubled(tally: Tally, i: int) -> float:
    judged, troubled = (int(n) for n in tally.windows[:, i])
    return troubled / judged if judged else 0.0


def _fill_table(report: Report, tally: Tally, specs: Specs, sites: Mapping[str, str]) -> None:
    """The table's columns, and a row per muscle."""
    table: list[tuple[Samples, Samples]] = []
    for name, running in zip(numbers(specs.get("statistics")), tally.fields, strict=True):
        if column := labels.column(name, specs["statistics"]):
            column.decimals = labels.decimals(name, column.decimals, running.centre())
            report.columns.append(column)
            table.append((running.centre(), running.spread()))
    for name, values in zip(numbers(specs.get("muscles")), tally.overall, strict=True):
        if name in OVERALL and (column := labels.column(name, specs["muscles"])):
            report.columns.append(column)
            table.append((values, np.full(len(values), np.nan)))
    for i, name in enumerate(specs["cycles"].channels):
        values = [(float(centre[i]), float(spread[i])) for centre, spread in table]
        report.muscles.append(
            Muscle(name, sites.get(name, ""), tally.flags[i], _remark(tally, specs, i), values, _troubled(tally, i))
        )
