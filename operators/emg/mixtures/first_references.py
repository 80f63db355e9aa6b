"""The references that a session's own first cycles make, one mixture after the other, a few sweeps at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.reference import ReferenceFit, References
from kinegraph.operators.emg.mixtures.refit import Fitting
from kinegraph.stream.chunk import Times


@dataclass(slots=True)
class FirstReferences:
    """
    known                  the references of each mixture
    held, slots (l, first) each limb's first cycles, once there are enough (`frozen`), and where they stand in it
    fit, job               the reference under way, and its mixture, or -1;  made (g,): 1 where it is done
    """

    known: References
    held: list[PeakWindow]
    frozen: Times
    slots: Times
    fit: ReferenceFit
    job: int
    made: Times

    @staticmethod
    def empty(mixtures: int, held: list[PeakWindow], first: int, fit: ReferenceFit) -> FirstReferences:
        """Of the `first` cycles of each limb."""
        limbs = len(held)
        frozen, slots, made = (
            np.zeros(limbs, np.int64),
            np.zeros((limbs, first), np.int64),
            np.zeros(mixtures, np.int64),
        )
        return FirstReferences(References.empty(mixtures), held, frozen, slots, fit, -1, made)

    def take(self, limb: int, window: PeakWindow) -> None:
        """Hold a limb's cycles in `window`, if they are the first and enough."""
        enough = self.slots.shape[1]
        if not self.frozen[limb] and len(slots := window.latest(enough, limb)) == enough:
            self.slots[limb], self.frozen[limb] = slots, 1
            self.held[limb].take(window)

    def forget(self, limb: int, mixtures: Sequence[int]) -> None:
        """A limb's cycles so far are no reference for its `mixtures` any more."""
        self.frozen[limb] = 0
        if self.job in mixtures:
            self.fit.abandon()
            self.job = -1
        for which in mixtures:
            self.made[which] = 0
            self.known.forget(which)

    def step(self, group: Times, limb: Times, size: int, how: Fitting) -> bool:
        """Does a piece of work, and returns whether any. `group` (g, ...): the channels of each mixture, or -1; `limb` (g,): its limb."""
        if self.job < 0:
            due = np.flatnonzero((self.frozen[limb] == 1) & (self.made == 0))
            if not len(due):
                return False
            self.job = int(due[0])
        channels, leg = group[self.job], int(limb[self.job])
        channels = channels[channels >= 0]
        if self.fit.go_on(self.held[leg], self.slots[leg], channels, self.job, size, self.known, how):
            self.made[self.job], self.job = 1, -1
        return True
