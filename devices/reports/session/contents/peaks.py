"""Where in the cycle each muscle is active: the latest mixture of its peaks, and how far it has moved, as a report tells it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kinegraph.devices.reports.session.contents.data import Grid
from kinegraph.stream.chunk import Array, Samples

MODE = ("place_pct", "height", "sd_pct", "sd_height", "correlation", "weight")
MOVED = ("from_first", "limit", "from_other")
NOTE = (
    "Gaussian mixtures of the local maxima of the latest cycles (Vögele 2016, 6.2.4): each mode's place in the cycle and height ± their"
    " standard deviations, and the share of peaks in it. Pictures: mean curve and modes (ellipses of two standard deviations) from -50 to"
    " 150 % of the cycle, so that an activity across the touch-down (dashed) is seen whole. Moved: Cauchy-Schwarz divergence of the latest"
    " cycles from the session's first, beside the limit that steady walking seldom exceeds; and from the other leg, where there is one."
)


@dataclass(slots=True)
class Peaks:
    """Of each mixture, by name: numbers, the cycle it is of; modes (k, 6), as `MODE` says; moved (3,), as `MOVED` says."""

    names: list[str] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    modes: list[Samples] = field(default_factory=list)
    moved: list[Samples] = field(default_factory=list)

    def add(self, port: str, rows: Array) -> None:
        for row in rows:
            i = self._place(str(row["name"]))
            if port == "distance":
                self.moved[i] = np.array([float(row[name]) for name in MOVED])
                continue
            mode = np.array([[float(row[name]) for name in MODE]])
            again = int(row["number"]) == self.numbers[i]
            self.modes[i] = np.concatenate([self.modes[i], mode]) if again else mode
            self.numbers[i] = int(row["number"])

    def _place(self, name: str) -> int:
        if name not in self.names:
            self.names.append(name)
            self.numbers.append(-1)
            self.modes.append(np.zeros((0, len(MODE))))
            self.moved.append(np.full(len(MOVED), np.nan))
        return self.names.index(name)

    def of(self, channel: str) -> Samples:
        """A channel's modes; of a joint mixture ("GM+GL"), those of all its channels."""
        found = [m for name, m in zip(self.names, self.modes, strict=True) if channel[:16] in (name, *name.split("+"))]
        return found[0] if found else np.zeros((0, len(MODE)))

    def grid(self, unit: str) -> Grid:
        columns = [
            ("Muscle", ""),
            ("Modes", f"% of the cycle; {unit or 'height'}; share"),
            ("Moved", ""),
            ("Limit", ""),
            ("Other leg", ""),
        ]
        rows = []
        for name, modes, moved in zip(self.names, self.modes, self.moved, strict=True):
            lines = [f"{p:.0f} ± {sp:.0f} %: {h:.3g} ± {sh:.2g} ({w:.0%})" for p, h, sp, sh, _, w in modes]
            rows.append(
                [name, "; ".join(lines) or "not known", *(f"{v:.3f}" if np.isfinite(v) else "–" for v in moved)]
            )
        return Grid("Activation peaks", NOTE, columns, rows)
