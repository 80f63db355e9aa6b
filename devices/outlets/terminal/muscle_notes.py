"""What is known of each muscle beside its numbers, in a few words: modes of its peaks, how far it has moved, targets, norms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array

NOTES = {
    "modes": ("name", "number", "place_pct", "height", "weight"),
    "distance": ("name", "from_first", "limit", "from_other"),
    "targets": ("name", "number", "from_pct", "to_pct", "value", "low", "high", "state", "hits", "cycles"),
    "norms": ("name", "number", "outside_pct", "furthest_pct", "beyond"),
}
"""By port: the fields that its events must have."""
HEADINGS = {
    "modes": "active at %",
    "distance": "moved (limit), other leg",
    "targets": "target",
    "norms": "outside norm",
}


@dataclass(slots=True)
class MuscleNotes:
    """names of muscles; per name and port the words, and the number of the cycle that they are about."""

    names: list[str] = field(default_factory=list)
    words: list[list[str]] = field(default_factory=list)
    numbers: list[list[int]] = field(default_factory=list)

    def add(self, port: str, rows: Array) -> None:
        k = list(NOTES).index(port)
        for row in rows:
            i = self._place(str(row["name"]))
            number = int(row["number"]) if "number" in NOTES[port] else 0
            word = REMARKS[port](row)
            again = number and number == self.numbers[i][k]
            self.words[i][k] = f"{self.words[i][k]}, {word}" if again else word
            self.numbers[i][k] = number

    def of(self, channel: str, port: str) -> str:
        """What is known of a channel; of a joint mixture ("GM+GL") it is known of each."""
        k = list(NOTES).index(port)
        found = [
            i for i, name in enumerate(self.names) if channel[:16] in (name, *name.split("+")) and self.words[i][k]
        ]
        return self.words[found[0]][k] if found else ""

    def _place(self, name: str) -> int:
        if name not in self.names:
            self.names.append(name)
            self.words.append([""] * len(NOTES))
            self.numbers.append([-1] * len(NOTES))
        return self.names.index(name)


def _mode(row: Any) -> str:
    return f"{row['place_pct']:.0f} ({row['weight']:.0%})"


def _distance(row: Any) -> str:
    first = f"{row['from_first']:.2f} ({row['limit']:.2f})" if np.isfinite(row["limit"]) else "not known"
    return f"{first}, {row['from_other']:.2f}" if np.isfinite(row["from_other"]) else first


def _target(row: Any) -> str:
    return f"{row['value']:.3g} {row['state']} {row['low']:.3g}-{row['high']:.3g} at {row['from_pct']:.0f}-{row['to_pct']:.0f} %"


def _norm(row: Any) -> str:
    side = "above" if row["beyond"] > 0 else "below"
    where = f", most at {row['furthest_pct']:.0f} % ({side})" if row["outside_pct"] else ""
    return f"{row['outside_pct']:.0f} % of the cycle{where}"


REMARKS = {"modes": _mode, "distance": _distance, "targets": _target, "norms": _norm}
