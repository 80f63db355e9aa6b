"""What the segmentation remembers, and what it says in the log of how far it is to be relied on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import structlog

from kinegraph.operators.features.mirror import STACKED
from kinegraph.operators.inputs.continuity import Continuity
from kinegraph.operators.segmentation.kernels.layout import Remembered
from kinegraph.stream.chunk import NS, Array, Samples

log = structlog.get_logger(__name__)
DOUBTFUL = 3
"""This many activities of which it is not sure that they repeat, and more than half of those that do, are worth a warning."""
FEW = 5
"""Fewer repetitions that are certain, in little motion, are too few to rely on."""


@dataclass(slots=True)
class SegmentState(Continuity):
    """memory: see layout.py; longest: ns, of a transition; mirrored: the newest mirror image (features,), if any; its stamp.

    absent: features (features,) already reported as missing; names: theirs. cut: activities; sure: repetitions of
    those that are certain; judged, doubtful: activities that repeated, and those of them that chance might have made; warned:
    whether that was reported.
    """

    memory: Remembered
    longest: int
    mirrored: Samples
    mirrored_at: int
    absent: Array
    names: list[str]
    cut: int = 0
    sure: int = 0
    judged: int = 0
    doubtful: int = 0
    warned: bool = False

    def say_missing(self, learnt: int) -> None:
        """Warn once about each feature that is left out because it had no value for a window, or since the start."""
        memory = self.memory
        if memory.present == self.width or max(memory.next_frame, memory.recent_count) < learnt * memory.learn:
            return
        missing = memory.next_frame - self.memory.known > memory.window
        fresh = missing & ~self.absent
        self.absent[:] = missing
        if fresh.any():
            names = dict.fromkeys(STACKED.sub("", self.names[k]) for k in np.flatnonzero(fresh))
            left = "features are left out of the comparison" if not missing.all() else "nothing can be compared"
            log.warning(
                f"{left}: no value has come for as long as the window, or since the start",
                features=", ".join(names), left=int(self.width - missing.sum()), of=self.width, t_ns=int(memory.now),
            )  # fmt: skip

    def judge(self, activities: Array) -> None:
        """Count activities that have been cut, and say once if most of what repeats comes no nearer to itself than chance: these sensors
        do not tell repetitions."""
        certainty = activities["certainty"]
        repeated = certainty[activities["repeats"]]
        self.cut += len(activities)
        self.sure += int(activities["repetitions"][certainty > 0.0].sum())
        self.judged += len(repeated)
        self.doubtful += int((repeated <= 0.0).sum())
        if not self.warned and self.doubtful >= DOUBTFUL and 2 * self.doubtful > self.judged:
            self.warned = True
            log.warning(
                "most of what is counted may be chance: repetitions lie as far apart as in motion of random phases;"
                " docs/method/segmentation.md says which sensors tell repetitions",
                doubtful=self.doubtful, of=self.judged, t_ns=int(self.memory.now),
            )  # fmt: skip

    def say_short(self) -> None:
        """If the whole stream held less motion than `firm`, few repetitions that are certain, and was cut or counted all the same."""
        memory = self.memory
        if memory.next_frame < memory.firm and self.sure < FEW and (self.cut > 1 or self.judged):
            log.warning(
                "too little motion to tell what repeats: what was cut and counted is not to be relied on;"
                " docs/method/segmentation.md says which sensors tell repetitions",
                motion_s=round(int(memory.next_frame) * self.period_ns / NS, 1), least_s=round(int(memory.firm) * self.period_ns / NS, 1),
                t_ns=int(self.last[0]),
            )  # fmt: skip
