"""The depths of the sleepers' beds, second by second, and what is known of them empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.bed.frames.seconds import Seconds, look, restless_blocks
from kinegraph.operators.bed.mattress import level, mattress, somebody
from kinegraph.stream.chunk import NEVER, NS, Samples, Times

PAUSE_NS = 5 * NS


@dataclass(slots=True)
class BedDepths:
    """
    regions    (k, 4)           in blocks: row, column, rows, columns; no rows: not known
    room       (rows, columns)  the frame while the bed was empty, NaN where not known
    empty      (rows, columns)  the empty bed's depth, NaN where not known
    mattress   (rows, columns)  while it is not known, the plane that most of the bed lies in; NaN where not known
    flat       (k,)             whether nothing stood out of the mattress in the newest stretch, while the bed was not known
    seconds                     the present second, and the present stretch of `learn_s`
    seen_now   (k, 3)           of the newest second: share raised, mean height (mm), share measured
    """

    regions: Times
    room: Samples
    empty: Samples
    mattress: Samples
    flat: Times
    seconds: Seconds
    seen_now: Samples

    @staticmethod
    def of(k: int, shape: tuple[int, ...]) -> BedDepths:
        unknown = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
        return BedDepths(
            np.zeros((k, 4), np.int64), *unknown, np.zeros(k, np.int64), Seconds.of(shape), np.full((k, 3), np.nan)
        )

    def end_second(self, rise: float) -> None:
        """The second is over: look how much of each region is more than `rise` above the empty bed."""
        self.seconds.end(PAUSE_NS)
        look(self.seconds.mean, self.empty, self.regions, rise, self.seen_now)

    def forget(self) -> None:
        """The camera was moved: nothing of this is known any more."""
        self.room[:] = self.empty[:] = self.mattress[:] = np.nan
        self.flat[:] = 0
        self.seconds.since = NEVER

    def part(self, k: int) -> tuple[slice, slice]:
        """The blocks of a sleeper's region."""
        row, column, rows, columns = self.regions[k].tolist()
        return slice(row, row + rows), slice(column, column + columns)

    def known(self, k: int) -> bool:
        """Whether the empty bed is."""
        return bool(np.isfinite(self.empty[self.part(k)]).any())

    def above(self, k: int) -> Samples:
        """How far each block of a sleeper's region is above the empty bed; NaN: not known."""
        part = self.part(k)
        above: Samples = self.empty[part] - self.seconds.mean[part]
        return above

    def above_mattress(self, k: int) -> Samples:
        """The same above the plane of the mattress, while the empty bed is not known."""
        part = self.part(k)
        above: Samples = self.mattress[part] - self.seconds.mean[part]
        return above

    def moving(self, k: int, least: float, rise: float, *, anywhere: bool) -> int:
        """How many blocks of a sleeper's region have moved in the stretch; -1: it was not seen.

        Unless `anywhere`, only those count that stand out of the empty bed, or else of the mattress, by half of `rise`, and their
        neighbours: what lifts a flat blanket is nobody.
        """
        found = restless_blocks(self.seconds.stretch, self.regions[k], least)
        if found is None:
            return -1
        ground = (self.empty if self.known(k) else self.mattress)[self.part(k)]
        if anywhere or 2 * np.isfinite(ground).sum() < ground.size:
            return int(found.sum())
        out = ground - self.stretch(k) > rise / 2
        near = np.pad(out, 1)
        for axis in (0, 1):
            near |= np.roll(near, 1, axis) | np.roll(near, -1, axis)
        return int((found & near[1:-1, 1:-1]).sum())

    def lies(self, k: int, rise: float, least: float) -> bool:
        """Whether what stands out of the mattress may be a body; what the stretch says of the mattress is kept."""
        part, depth = self.part(k), self.stretch(k)
        self.mattress[part] = mattress(depth, rise / 2)
        self.flat[k] = level(self.mattress[part] - depth, rise)
        return somebody(self.mattress[part] - depth, rise, least)

    def stretch(self, k: int) -> Samples:
        """The mean depths of a sleeper's region in the stretch."""
        return self.seconds.depth()[self.part(k)]

    def learn(self, k: int) -> None:
        """The stretch shows the empty bed."""
        part, depth, room = self.part(k), self.stretch(k), self.seconds.depth()
        self.room[:] = np.where(np.isfinite(room), room, self.room)
        self.empty[part] = np.where(np.isfinite(depth), depth, self.empty[part])
