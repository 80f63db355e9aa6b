"""What goes wrong during a soak, and when: drawn from a seed, so that a fault that was found can be made again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

Kind = Literal[
    "unplug",
    "suspend",
    "kill",
    "full disk",
    "broker down",
    "clock step",
    "stuck broker",
    "slow clients",
    "machine asleep",
]
KINDS: tuple[Kind, ...] = get_args(Kind)

EVERY_S: dict[Kind, float] = {
    "unplug": 25,
    "suspend": 50,
    "kill": 60,
    "full disk": 75,
    "broker down": 75,
    "clock step": 90,
    "stuck broker": 75,
    "slow clients": 60,
    "machine asleep": 90,
}
"""How often each happens to each session, in the mean."""
FOR_S: dict[Kind, tuple[float, float]] = {
    "unplug": (0.2, 6.0),
    "suspend": (0.2, 8.0),
    "kill": (0.0, 3.0),
    "full disk": (0.5, 6.0),
    "broker down": (0.5, 10.0),
    "clock step": (5.0, 60.0),
    "stuck broker": (1.0, 20.0),
    "slow clients": (2.0, 30.0),
    "machine asleep": (0.2, 3.0),
}
"""The least and the most that each lasts; after a kill: until somebody starts the session again."""


@dataclass(frozen=True, slots=True, order=True)
class Fault:
    at_s: float
    kind: Kind
    use: str
    for_s: float


def drawn(
    seed: int,
    seconds: float,
    uses: tuple[str, ...],
    *,
    only: tuple[Kind, ...] = KINDS,
    quiet_s: float = 15.0,
    pace: float = 1.0,
) -> list[Fault]:
    """All faults of a soak in the order of their begin, `pace` times as often as `EVERY_S` says.

    The first and the last `quiet_s` are without; of a kind and use there is one at a time. Those of one kind are the same whatever others
    there are.
    """
    faults = []
    for i, use in enumerate(uses):
        for j, kind in enumerate(KINDS):
            if kind not in only:
                continue
            random = np.random.default_rng([seed, i, j])
            least, most = FOR_S[kind]
            at = quiet_s + random.uniform(0, EVERY_S[kind] / pace)
            while True:
                for_s = random.uniform(least, most)
                if at + for_s > seconds - quiet_s:
                    break
                faults.append(Fault(at, kind, use, for_s))
                at += for_s + random.exponential(EVERY_S[kind] / pace)
    return sorted(faults)
