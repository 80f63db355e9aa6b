"""Both legs of one walker: two signals at one pace, half a stride apart, and the two belts' forces with the faults of real plates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinegraph.devices.people.treadmill.faults import Fault, Faults
from kinegraph.devices.people.treadmill.signal import Indices, Signal, Walker
from kinegraph.stream.chunk import Samples

LEGS = {"left": "L_", "right": "R_"}
LEFT_SEED = 1 << 40


class BothLegs:
    """EMG and force of two legs for any range of samples; the right one is what `Signal` makes of the walker."""

    def __init__(self, walker: Walker, left_share: float) -> None:
        left = replace(walker, seed=walker.seed + LEFT_SEED, pace_seed=walker.seed, lag=0.5, share=left_share)
        self.legs = {"left": Signal(left), "right": Signal(walker)}
        self.faults: dict[str, Faults] = {}

    def spoil(self, faults: tuple[Fault, ...]) -> Faults:
        """Put the faults in, each into the leg with the prefix of its muscle; gives those that lose samples."""
        for side, signal in self.legs.items():
            prefix = LEGS[side]
            mine = tuple(
                replace(f, muscle=f.muscle.removeprefix(prefix))
                if f.muscle.startswith(prefix) or not f.muscle
                else None
                for f in faults
            )
            self.faults[side] = Faults(tuple(f for f in mine if f is not None), signal)
            signal.spoil = self.faults[side].spoil
        return Faults(faults, self.legs["right"])

    def read(self, start: int, stop: int) -> tuple[Samples, Samples]:
        """Samples start..stop-1: EMG (n, 2 m), the left leg's muscles first, in uV; vertical force (n, 2) in N, the left belt first."""
        made = [signal.read(start, stop) for signal in self.legs.values()]
        return np.hstack([emg for emg, _ in made]), np.hstack([force for _, force in made])

    def contacts(self, kind: str, start: int, stop: int) -> tuple[Indices, list[str]]:
        """Touch-downs or lift-offs of both feet at samples start..stop-1, and their sides."""
        at, sides = [], []
        for side, signal in self.legs.items():
            found = getattr(signal.gait, f"{kind}s")(start, stop)
            at.append(found)
            sides += [side] * len(found)
        index = np.concatenate(at)
        order = np.argsort(index, kind="stable")
        return index[order], [sides[i] for i in order]


def plates(force: Samples, seconds: Samples, drift_n_per_min: float, cross_talk_pct: float) -> Samples:
    """What the two belts' plates (n, 2) show: each drifts, and shows a part of the other's load."""
    return np.asarray(force + cross_talk_pct / 100 * force[:, ::-1] + drift_n_per_min * seconds[:, None] / 60)
