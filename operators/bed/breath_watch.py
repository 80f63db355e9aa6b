"""Whether a sleeper's breath is seen, window by window: evidence of a body for those who decide who is in bed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.bed.breath_cells import LOWEST, BreathCells
from kinegraph.stream.chunk import NEVER, NS, Samples, Times

WINDOW_S = 30.0
WINDOW_NS = round(WINDOW_S * NS)
"""Windows are the epochs of `operators.bed.breathing.Breathing`, so that both say the same."""
STILL_MM_S, CONFIDENT = 20.0, 0.5
FORGETS = 0.05
"""How fast old windows are forgotten."""
LULL, DOUBT = 2, 0.01
"""At least this many still windows in a row without breath, and as many as a sleeper would have less often than this, leave no evidence of
a body: 2 where breath was always seen for long, 4 where it was in three windows of four."""


@dataclass(slots=True)
class BreathWatch:
    """
    cells    None: the frames are too few for breath
    window   begin of the open window (ns); NEVER: none
    seen     (k,) end of the newest window with breath (ns); NEVER: none
    run      (k,) windows in a row with breath: after silence a single one may be noise
    lull     (k,) still windows in a row without breath
    share, count (k,) of the still windows in bed: how many had breath, and how many there were
    """

    cells: BreathCells | None
    window: int
    seen: Times
    run: Times
    lull: Times
    share: Samples
    count: Samples

    @staticmethod
    def of(k: int, shape: tuple[int, ...], rate_hz: float) -> BreathWatch:
        enough = rate_hz and 60 * rate_hz * 0.45 >= 2 * LOWEST
        cells = BreathCells.of(shape, rate_hz, WINDOW_S, 0, STILL_MM_S) if enough else None
        run, lull = np.zeros(k, np.int64), np.zeros(k, np.int64)
        return BreathWatch(cells, NEVER, np.full(k, NEVER), run, lull, np.ones(k), np.zeros(k))

    def add(self, blocks: Samples, time: int) -> None:
        """A frame's blocks (rows, columns)."""
        if self.cells is None:
            return
        if time // WINDOW_NS * WINDOW_NS != self.window:
            self.window = time // WINDOW_NS * WINDOW_NS
            self.cells.forget()
        self.cells.add(blocks, time)

    def forget(self) -> None:
        """The picture is another one."""
        self.window = NEVER
        self.run[:] = self.lull[:] = 0

    def left(self, k: int) -> None:
        """The bed is empty."""
        self.lull[k], self.share[k], self.count[k] = 0, 1.0, 0.0

    def end(self, end: int, regions: Times, in_bed: list[bool]) -> bool:
        """The window that ends at `end`, if one does: whether it was looked at."""
        if self.cells is None or self.window == NEVER or end != self.window + WINDOW_NS:
            return False
        for k, breath in enumerate(self.cells.breaths(self.window, regions)):
            confidence, moved = breath.confidence, breath.moved
            breathes = confidence >= CONFIDENT
            if not len(breath.cells) and not moved:
                continue  # too little was measured to see breath: that is no evidence of anything
            self.run[k] = self.run[k] + 1 if breathes else 0
            believed = breathes and (self.run[k] > 1 or not self.silent(k))
            if believed:
                self.seen[k] = end
            self.lull[k] = 0 if believed or moved else self.lull[k] + (not breathes)
            if in_bed[k] and not moved and self.lull[k] < LULL:
                self.count[k] += 1
                self.share[k] += (breathes - self.share[k]) * max(FORGETS, 1 / self.count[k])
        self.window = NEVER
        return True

    def silent(self, k: int) -> bool:
        """Whether nothing breathes for longer than the sleeper's breath was ever hidden, if it was seen at all."""
        usual = (self.share[k] * self.count[k] + 1) / (self.count[k] + 2)
        return bool(self.share[k] and self.count[k] and self.lull[k] >= LULL and (1 - usual) ** self.lull[k] < DOUBT)
