"""One CSV row per gait cycle, rejected ones with their reason: a cycle's event joined to its numbers, muscle by muscle."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.reports.session.contents.tally import numbers
from kinegraph.stream.chunk import NS, Array, Samples, Specs, StreamSpec
from kinegraph.stream.data.csv_writer import row_of
from kinegraph.stream.system.atomic_file import complete

CYCLE = ("duration_s", "stance_pct", "cadence")
EMPTY = -1


@dataclass(slots=True)
class Held:
    """A cycle that waits for its numbers: its event (1,), and the numbers (fields, m) so far; number -1: empty. `limbs`,
    `sizes`: where there are several, how many muscles each has."""

    number: int
    event: Array
    values: Samples
    came: int
    flags: list[str]
    limbs: list[str]
    sizes: list[int]


@dataclass(frozen=True, slots=True)
class About:
    """What is the same in every row: what amplitudes are relative to, and the recording's name, or ""."""

    amplitudes: str
    recording: str = ""


def nothing_held(specs: Specs) -> Held:
    fields, muscles = len(numbers(specs.get("statistics"))), specs["cycles"].shape[1]
    limbs = dict(specs["cycles"].meta.get("limbs") or {}) if "limb" in (specs["closed"].dtype.names or ()) else {}
    return Held(
        EMPTY, np.zeros(1, specs["closed"].dtype), np.full((fields, muscles), np.nan), 0, _no_flags(specs),
        list(limbs), [len(mine) for mine in limbs.values()],
    )  # fmt: skip


def _no_flags(specs: Specs) -> list[str]:
    """One per muscle, if flags are reported."""
    text = "statistics" in specs and "flag" in (specs["statistics"].dtype.names or ())
    return [""] * specs["cycles"].shape[1] if text else []


def header(specs: Specs) -> bytes:
    """The first line: names with units."""
    closed, statistics = specs["closed"], specs.get("statistics")
    names = [
        "touch-down (UTC)",
        "touch-down (s)",
        "number",
        *(_named(f, closed) for f in _more(closed.dtype)),
        *(_named(f, closed) for f in CYCLE),
        "rejected",
        "amplitudes",
        "recording",
    ]
    if statistics is not None:
        fields = numbers(statistics)
        names += [f"{muscle} {_named(f, statistics)}" for muscle in specs["cycles"].channels for f in fields]
        names += [f"{muscle} signal" for muscle, _ in zip(specs["cycles"].channels, _no_flags(specs), strict=False)]
    return row_of(names)


def take_closed(held: Held, rows: Array, start_ns: int, about: About) -> bytes:
    """Take events of cycles; returns the lines that are complete with them."""
    lines = b""
    for i in range(len(rows)):
        lines += release(held, start_ns, about)
        held.number, held.came = int(rows["number"][i]), 0
        held.event[0] = rows[i]
        held.values[:] = np.nan
        held.flags = [""] * len(held.flags)
        if rows["rejected"][i] or not held.values.size:
            lines += release(held, start_ns, about)
    return lines


def take_statistics(held: Held, rows: Array, fields: Sequence[str], start_ns: int, about: About) -> bytes:
    """Take numbers of muscles; returns the line of the held cycle, if they were the last that it lacked."""
    mine = rows[rows["number"] == held.number]
    for i, name in enumerate(fields):
        held.values[i, mine["muscle"]] = mine[name]
    for row in mine if held.flags else ():
        held.flags[int(row["muscle"])] = str(row["flag"])
    held.came += len(mine)
    return release(held, start_ns, about) if held.came >= _awaited(held) else b""


def _more(closed: np.dtype[Any]) -> list[str]:
    """What is known of a cycle beside its times: its limb, its stage, the belt's speed."""
    return [name for name in ("limb", "stage", "speed_m_s") if name in (closed.names or ())]


def _awaited(held: Held) -> int:
    """How many muscles the held cycle has."""
    if not held.limbs or held.number == EMPTY:
        return int(held.values.shape[1])
    return held.sizes[held.limbs.index(str(held.event["limb"][0]))]


def release(held: Held, start_ns: int, about: About) -> bytes:
    """The line of the held cycle, with what has come of it, if any."""
    if held.number == EMPTY:
        return b""
    event = held.event[0]
    onset = int(event["onset"])
    values: list[Any] = [f"{np.datetime64(onset, 'ns')}Z", f"{(onset - start_ns) / NS:.6f}", held.number]
    values += [event[name].item() for name in _more(event.dtype)]
    values += [float(event[name]) for name in CYCLE]
    values += [str(event["rejected"]), about.amplitudes, about.recording, *held.values.T.ravel().tolist(), *held.flags]
    held.number = EMPTY
    return row_of(values)


def settle(path: Path) -> None:
    """Leave one row per cycle in a finished table: of those reported twice, the last one, where the first one was. Raises OSError."""
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    where = head.index("number")
    last = {row[where]: row for row in rows}
    with complete(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *last.values()])


def _named(field: str, spec: StreamSpec) -> str:
    """The field with its unit, unless its name ends with it."""
    unit = spec.unit_of(field)
    return f"{field} ({unit})" if unit and not field.endswith(("_s", "_pct", "_m_s")) else field
