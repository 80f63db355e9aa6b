"""The last gait cycle on the terminal: a table in the live view, one plain line per cycle elsewhere."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from kinegraph.devices.outlets.terminal.muscle_notes import HEADINGS, NOTES, REMARKS, MuscleNotes
from kinegraph.devices.outlets.terminal.view import TerminalView
from kinegraph.devices.reports.session.contents.labels import decimals, relative_to
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.text.safe_text import say

CYCLE = ("number", "duration_s", "stance_pct", "cadence", "rejected")


@dataclass(slots=True)
class CycleTableState:
    """The cycle that waits for its numbers: its event (1,), the numbers (fields, m) so far; counts of cycles; and the latest, a ring:
    their numbers, and whether they were accepted. Of several limbs, each one's latest rows."""

    event: Array
    values: Samples
    came: int
    accepted: int
    rejected: int
    numbers: Times
    taken: Times
    limbs: list[str]
    latest: list[Array]
    notes: MuscleNotes


@dataclass(frozen=True, slots=True)
class CycleTable(Outlet[CycleTableState, StreamSpec]):
    """Every cycle as it closes: its duration, stance and cadence, and what was measured of each muscle; rejected ones with the reason.

    closed       of `operators.cycles.cycles.Cycles`
    statistics   of `operators.cycles.statistics.CycleStatistics`

    stages       of `operators.cycles.stages.Stages`: which stage has begun, and the text to show
    modes        of `operators.emg.mixtures.PeakMixtures`, and
    distance     of `operators.emg.mixtures.drift.MixtureDrift`, and
    targets      of `operators.cycles.statistics.cycle_targets.CycleTargets`, and
    norms        of `operators.cycles.statistics.norms.NormativeBands` (`against`): a column of the table each

    Of several limbs the table shows each one's latest cycle, muscle by muscle over one another.

    `kinegraph run` shows the newest cycle as a table in its live view; where the output is no terminal, every cycle is a line.
    """

    inputs = {"closed": Input(), "statistics": Input(), **dict.fromkeys(("stages", *NOTES), Input(optional=True))}

    fields: tuple[str, ...] = param(
        ("peak", "peak_pct", "mean", "integrated", "deviation"), help="which numbers of `statistics` are shown"
    )

    def open(self, specs: Specs) -> Specs:
        closed, statistics = specs["closed"], specs["statistics"]
        if not set(CYCLE) <= set(closed.dtype.names or ()):
            raise InputError("closed", closed.describe(), f"events with the fields {', '.join(CYCLE)}")
        if not {"number", "muscle", "name"} <= set(statistics.dtype.names or ()):
            raise InputError("statistics", statistics.describe(), "events with the fields number, muscle, name")
        for port, fields in NOTES.items():
            if port in specs and not set(fields) <= set(specs[port].dtype.names or ()):
                raise InputError(port, specs[port].describe(), f"events with the fields {', '.join(fields)}")
        for field in self.fields:
            if field not in statistics.channels or statistics.dtype[field].kind != "f":
                known = [name for name in statistics.channels if statistics.dtype[name].kind == "f"]
                raise ParameterError("fields", field, f"a number of `statistics`; {nearest(field, known)}")
        self.set_state(
            CycleTableState(
                np.zeros(0, closed.dtype),
                np.zeros((len(self.fields), 0)),
                0,
                0,
                0,
                np.full(64, -1),
                np.zeros(64, np.int64),
                [],
                [],
                MuscleNotes(),
            ),
            statistics,
        )
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        state = self.state
        if port == "stages":
            for row in chunk.data:
                _print_stage(row)
        elif port in NOTES:
            state.notes.add(port, chunk.data)
            if port in ("targets", "norms") and len(chunk):
                _print_rows(port, chunk.data)
        elif port == "closed":
            for i in range(len(chunk)):
                event = chunk.data[i : i + 1]
                again = _count(state, int(event["number"][0]), not event["rejected"][0])
                if again and event["rejected"][0]:
                    _show(headline(event, state), f"{rejection(event)} (taken back)")
                    continue
                state.event = event.copy()
                if event["rejected"][0]:
                    _show(headline(event, state), rejection(event))
        elif len(chunk) and len(state.event):
            rows = chunk.data[chunk.data["number"] == state.event["number"][0]]
            if len(rows):
                spec = self.runtime
                table = cycle_table(
                    headline(state.event, state), _beside(state, rows, spec), self.fields, spec, state.notes
                )
                _show(table, cycle_line(state.event, rows, self.fields, spec))


def _beside(state: CycleTableState, rows: Array, spec: StreamSpec) -> Array:
    """The rows to be shown: of several limbs, each one's latest, a muscle's over one another."""
    room = rows.dtype["name"].itemsize // 4  # longer names are cut off in events
    limbs = {limb: [name[:room] for name in mine] for limb, mine in dict(spec.meta.get("limbs") or {}).items()}
    muscles = {name[:room]: muscle for name, muscle in dict(spec.meta.get("muscles") or {}).items()}
    limb = next((name for name, mine in limbs.items() if str(rows["name"][0]) in mine), "")
    if not limb:
        return rows
    if limb not in state.limbs:
        state.limbs.append(limb)
        state.latest.append(rows)
    state.latest[state.limbs.index(limb)] = rows.copy()
    both = np.concatenate(state.latest)
    order = list(dict.fromkeys(muscles.values()))
    places = [order.index(muscles[str(name)]) for name in both["name"]]
    return both[np.lexsort((both["name"], np.array(places)))]


def _print_stage(row: Any) -> None:
    """A stage has begun, or the last one has ended."""
    speed = f" at {row['speed_m_s']:.2f} m/s" if np.isfinite(row["speed_m_s"]) else ""
    before = f" ({row['cycles']} good cycles before it)" if row["number"] > 1 else ""
    what = (
        f"stage {row['number']}: {row['stage']}{speed}{before}" if row["stage"] else f"the protocol has ended{before}"
    )
    line = f"{what}. {row['say']}" if row["say"] else what
    if TerminalView.current is None:
        with suppress(BrokenPipeError):  # the output was closed
            say(line, flush=True)
    else:
        TerminalView.current.hang_out("stage", line, line)


def _print_rows(port: str, rows: Array) -> None:
    """How the last cycle stands to each target, or norm."""
    kind = port.removesuffix("s")
    lines = [
        f"{kind} {row['name']}: {REMARKS[port](row)}"
        + (f", {row['hits']} of {row['cycles']} cycles within" if port == "targets" else "")
        for row in rows
    ]
    if TerminalView.current is None:
        with suppress(BrokenPipeError):  # the output was closed
            say("; ".join(lines), flush=True)
    else:
        TerminalView.current.hang_out(kind, "\n".join(lines), "; ".join(lines))


def _count(state: CycleTableState, number: int, taken: bool) -> bool:
    """Count a cycle; gives whether it had been reported before, which then no longer counts."""
    found = np.flatnonzero(state.numbers == number)
    k = int(found[0]) if len(found) else (state.accepted + state.rejected) % len(state.numbers)
    if len(found):
        state.accepted -= int(state.taken[k])
        state.rejected -= 1 - int(state.taken[k])
    state.numbers[k], state.taken[k] = number, taken
    state.accepted += taken
    state.rejected += not taken
    return bool(len(found))


def headline(event: Array, state: CycleTableState) -> str:
    """The newest cycle, and how many there were."""
    what = rejection(event) if event["rejected"][0] else _what(event)
    return f"{what}\n{state.accepted} accepted, {state.rejected} rejected"


def rejection(event: Array) -> str:
    return f"cycle {event['number'][0]}  {event['duration_s'][0]:.3f} s  rejected: {event['rejected'][0]}"


def cycle_table(
    title: str, rows: Array, fields: tuple[str, ...], spec: StreamSpec, notes: MuscleNotes | None = None
) -> Table:
    """One row per muscle."""
    table = Table(
        title=f"{title}\namplitudes {relative_to(spec.meta)}",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        header_style="dim",
    )
    table.add_column("muscle")
    for field in fields:
        table.add_column(f"{_short(field)} {spec.unit_of(field)}".strip(), justify="right")
    written = [[str(name) for name in rows["name"]], *(_numbers(field, rows[field]) for field in fields)]
    for port in NOTES if notes else ():
        lines = [notes.of(str(name), port) if notes else "" for name in rows["name"]]
        if any(lines):
            table.add_column(HEADINGS[port])
            written.append(lines)
    for cells in zip(*written, strict=True):
        table.add_row(*cells)
    return table


def cycle_line(event: Array, rows: Array, fields: tuple[str, ...], spec: StreamSpec) -> str:
    """The cycle, then the first number of each muscle, its unit and, if it is shown, where the peak lies: "TA 91.2@76%"."""
    first = next((field for field in fields if field != "peak_pct"), "")
    parts = []
    numbers = _numbers(first, rows[first]) if first else [""] * len(rows)
    for row, number in zip(rows, numbers, strict=True):
        place = f"@{row['peak_pct']:.0f}%" if "peak_pct" in fields and np.isfinite(row["peak_pct"]) else ""
        parts.append(f"{row['name']} {number}{place}")
    if not first:
        return f"{_what(event)}  {'peak at' if fields else ''}: {', '.join(parts)}"
    unit = spec.unit_of(first)
    about = f" in {unit}, {relative_to(spec.meta)}" if unit else ""
    return f"{_what(event)}  {_short(first)}{about}: {', '.join(parts)}"


def _what(event: Array) -> str:
    row: Any = event[0]
    stance = f"  stance {row['stance_pct']:.1f} %" if np.isfinite(row["stance_pct"]) else ""
    where = "".join(f"  {row[name]}" for name in ("limb", "stage") if name in row.dtype.names and row[name])
    return f"cycle {row['number']}{where}  {row['duration_s']:.3f} s{stance}  {row['cadence']:.1f} strides/min"


def _short(field: str) -> str:
    return {"peak_pct": "peak at", "integrated": "iEMG"}.get(field, field.replace("_", " "))


def _numbers(field: str, values: Array) -> list[str]:
    """A field of all muscles, with as many decimals for each."""
    least = 0 if field.endswith("_pct") else 2 if field == "deviation" or field.startswith("integrated") else 1
    places = decimals(field, least, values)
    return [f"{value:.{places}f}" if np.isfinite(value) else "–" for value in values.tolist()]


def _show(notice: Any, line: str) -> None:
    if TerminalView.current is None:
        with suppress(BrokenPipeError):  # the output was closed
            say(line, flush=True)
    else:
        TerminalView.current.hang_out("cycle", notice, line)
