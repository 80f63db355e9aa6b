"""What a person typed during a session: when, in which cycle, and the text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.devices.reports.session.contents.data import Grid
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.data.csv_writer import Sheet
from kinegraph.stream.system.atomic_file import complete

LISTED, RECENT = 1000, 64
REMARK = np.dtype([("onset", "<i8"), ("text", "<U64"), ("cycles", "<U64")])
CYCLE = np.dtype([("onset", "<i8"), ("end", "<i8"), ("name", "<U32")])
NOTE = "What was typed during the session, commands included, and the cycle in which its first key was pressed."


@dataclass(slots=True)
class Remarks:
    """rows (1000,): the first `count` are there;  cycles (64,): the latest, a ring;  seen: in all."""

    rows: Array
    count: int
    cycles: Array
    seen: int

    @staticmethod
    def empty() -> Remarks:
        return Remarks(np.zeros(LISTED, REMARK), 0, np.zeros(RECENT, CYCLE), 0)

    def add(self, onset: int, text: str) -> None:
        """One more remark; beyond the thousandth it is left to the recording."""
        if self.count < LISTED:
            self.rows[self.count] = onset, text, ""
            self.count += 1
            for cycle in self.cycles[: min(self.seen, RECENT)]:
                self._join(cycle)

    def closed(self, row: np.void) -> None:
        """A cycle has ended, or is reported again."""
        limb = f"{row['limb']} " if "limb" in (row.dtype.names or ()) else ""
        name = f"{limb}{row['number']}"
        if (self.cycles["name"] == name).any():
            return
        k = self.seen % RECENT
        self.cycles[k] = row["onset"], row["end"], name
        self.seen += 1
        self._join(self.cycles[k])

    def _join(self, cycle: np.void) -> None:
        kept = self.rows[: self.count]
        for row in kept[(kept["onset"] >= cycle["onset"]) & (kept["onset"] < cycle["end"])]:
            names = [name for name in str(row["cycles"]).split(", ") if name]
            if str(cycle["name"]) not in names:
                here = kept["onset"] == row["onset"]
                kept["cycles"][here] = ", ".join(sorted([*names, str(cycle["name"])]))

    def grid(self, started: int) -> Grid:
        columns = [("Remark", ""), ("Time", "s from the start"), ("Cycle", "")]
        rows = [
            [str(r["text"]), f"{(int(r['onset']) - started) / NS:.1f}", str(r["cycles"]) or "–"] for r in self._kept()
        ]
        return Grid("Remarks", NOTE, columns, rows)

    def write(self, path: Path, started: int, recording: str) -> None:
        """Write them as a table, whole or not at all. Raises OSError."""
        with complete(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
            sheet = Sheet(file)
            sheet.writerow(["time (UTC)", "time (s)", "cycle", "remark", "recording"])
            for r in self._kept():
                onset = int(r["onset"])
                when = f"{np.datetime64(onset, 'ns')}Z", f"{(onset - started) / NS:.3f}"
                sheet.writerow([*when, str(r["cycles"]), str(r["text"]), recording])

    def _kept(self) -> Array:
        return np.sort(self.rows[: self.count], order="onset")
