"""Where what is compared with first cycles begins again: at a new stage, or another speed of the belt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times

ANOTHER_SPEED_M_S = 0.1
"""A larger difference is another belt speed; a smaller one is the belt's unevenness under a foot."""


@dataclass(slots=True)
class StageUnderWay:
    """Of each limb (l,): its stage and the belt's speed in m/s (NaN: not known), and the number of the first cycle in it; -1 before.

    Cycles' events without the fields `stage` and `speed_m_s` (`operators.cycles.stages.Stages`) are of one stage.
    """

    names: Array
    speeds: Samples
    since: Times

    @staticmethod
    def empty(limbs: int) -> StageUnderWay:
        return StageUnderWay(np.zeros(limbs, "<U32"), np.full(limbs, np.nan), np.full(limbs, -1))

    def begins(self, limb: int, closed: np.void) -> bool:
        """Whether another stage has begun for a limb with this cycle. A cycle across two stages counts for neither; a returning one of an
        earlier stage (`holds`) begins no stage."""
        number = int(closed["number"])
        if "stage" not in (closed.dtype.names or ()) or number < self.since[limb]:
            return False
        name, speed = str(closed["stage"]), float(closed["speed_m_s"])
        first, same = self.since[limb] < 0, name == str(self.names[limb])
        if not first and same and not abs(speed - self.speeds[limb]) > ANOTHER_SPEED_M_S:
            self.speeds[limb] = speed if np.isnan(self.speeds[limb]) else self.speeds[limb]
            return False
        self.names[limb], self.speeds[limb], self.since[limb] = name, speed, number
        return not first

    def holds(self, limb: int, number: int) -> bool:
        """Whether a limb's cycle is of the stage under way, not of one before."""
        return bool(number >= self.since[limb])
