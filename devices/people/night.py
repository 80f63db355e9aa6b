"""A night's plan, made along a hypnogram: when the sleeper is in bed, moves, turns over, gets up, and how fast the breath goes.

All of it is made up but for the hypnogram: enough to test what is done with frames, nothing to learn about sleep from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EPOCH_S = 30.0
WAKE, N1, N2, N3, REM = "W", "N1", "N2", "N3", "R"
Curve = NDArray[np.float64]

BREATHS = {WAKE: 15.0, N1: 14.0, N2: 13.0, N3: 12.5, REM: 14.5}
"""Breaths per minute."""
MOVES = {WAKE: 0.8, N1: 0.25, N2: 0.05, N3: 0.02, REM: 0.10}
"""How likely an epoch has movement."""
STILL_WAKE = 0.25
"""How likely five minutes awake are spent without any movement."""
RISE_S = 6.0
"""How long it takes to get into bed or out of it."""


@dataclass(frozen=True, slots=True)
class Act:
    """One movement: when (s since the night's beginning), how long, what (a limb, "turn", "in", "out"), how high (mm)."""

    onset_s: float
    duration_s: float
    part: str
    size_mm: float

    @property
    def end_s(self) -> float:
        return self.onset_s + self.duration_s


@dataclass(frozen=True, slots=True)
class NightPlan:
    """
    stages      of every epoch from `bed_s` on: W, N1, N2, N3, R
    bed_s, up_s when the sleeper first gets into bed and finally leaves it; length_s of the whole night, both s since its beginning
    acts        all movements, in order, without overlap
    absent      (k, 2)  when the bed is empty: from the beginning of getting up to the end of lying down
    phase       of the breath (cycles), every second
    """

    stages: tuple[str, ...]
    bed_s: float
    up_s: float
    length_s: float
    acts: tuple[Act, ...]
    absent: Curve
    phase: Curve

    def moved_s(self) -> Curve:
        """(epochs,) of the whole night: how many seconds of each had movement of the sleeper's."""
        moved = np.zeros(int(np.ceil(self.length_s / EPOCH_S)))
        for act in self.acts:
            for epoch in range(int(act.onset_s // EPOCH_S), min(len(moved) - 1, int(act.end_s // EPOCH_S)) + 1):
                begin = epoch * EPOCH_S
                moved[epoch] += max(0.0, min(act.end_s, begin + EPOCH_S) - max(act.onset_s, begin))
        return moved

    def in_bed(self, seconds: float) -> bool:
        return not any(begin <= seconds < end for begin, end in self.absent)

    def stage(self, seconds: float) -> str:
        """W while out of bed."""
        epoch = int((seconds - self.bed_s) // EPOCH_S)
        return self.stages[epoch] if 0 <= epoch < len(self.stages) and self.in_bed(seconds) else WAKE

    def breaths_per_min(self, begin_s: float, end_s: float) -> float:
        """The mean rate of breath in this time."""
        at = np.interp([begin_s, end_s], np.arange(len(self.phase)), self.phase)
        return float(60 * (at[1] - at[0]) / (end_s - begin_s))


def plan(
    stages: Sequence[str], *, evening_s: float = 300.0, morning_s: float = 300.0, exits: int = 2, seed: int = 0
) -> NightPlan:
    """A night along these stages (one per 30 s in bed). Exits fall into the longest stretches of wake between sleep."""
    random = np.random.default_rng([seed, 11])
    up = evening_s + len(stages) * EPOCH_S
    length = up + RISE_S + morning_s
    away = _exits(stages, evening_s, exits, random)
    acts = [Act(evening_s, RISE_S, "in", 60.0), Act(up, RISE_S, "out", 60.0)]
    for leave, back in away:
        acts += [Act(leave, RISE_S, "out", 60.0), Act(back, RISE_S, "in", 60.0)]
    absent = [(0.0, evening_s + RISE_S), *((leave, back + RISE_S) for leave, back in away), (up, length)]
    wanted = sorted(acts, key=lambda act: act.onset_s)
    for act in _movements(stages, evening_s, random):
        clear = all(act.end_s + 1 < a.onset_s or act.onset_s > a.end_s + 1 for a in wanted)
        if clear and not any(begin - 1 < act.end_s and act.onset_s < end + 1 for begin, end in absent):
            wanted.append(act)
    ordered = tuple(sorted(wanted, key=lambda act: act.onset_s))
    rates = np.array([BREATHS[s] for s in stages]) if stages else np.array([14.0])
    second = np.arange(int(length) + 2)
    rate = np.interp(second, evening_s + (np.arange(len(rates)) + 0.5) * EPOCH_S, rates)
    rate = rate + 0.6 * np.sin(2 * np.pi * second / 211) + 0.4 * np.sin(2 * np.pi * second / 47)
    return NightPlan(
        tuple(stages), evening_s, up, length, ordered, np.array(absent), np.concatenate([[0.0], np.cumsum(rate / 60)])
    )


def made_up(hours: float, seed: int = 0) -> tuple[str, ...]:
    """A hypnogram that looks like one: falling asleep, cycles of about 90 min, short awakenings, some long ones."""
    random = np.random.default_rng([seed, 12])
    n = round(hours * 3600 / EPOCH_S)
    stages: list[str] = [WAKE] * min(n, int(random.integers(16, 40)))
    cycle = 0
    while len(stages) < n:
        deep = max(4, round(60 - 14 * cycle + random.normal(0, 4)))
        for stage, count in (
            (N1, 4),
            (N2, 40 + int(random.integers(20))),
            (N3, deep),
            (N2, 24),
            (REM, 20 + 12 * cycle),
        ):
            stages += [stage] * count
            if random.random() < 0.5:
                stages += [WAKE] * int(random.integers(1, 6))
        if random.random() < 0.7:
            stages += [WAKE] * int(random.integers(10, 36))
        cycle += 1
    stages = stages[:n]
    awake = min(n, int(random.integers(6, 20)))
    return tuple(stages[: n - awake] + [WAKE] * awake)


def _exits(stages: Sequence[str], bed_s: float, count: int, random: np.random.Generator) -> list[tuple[float, float]]:
    """When the sleeper leaves and comes back: in the longest stretches of wake that have sleep on both sides."""
    asleep = [k for k, stage in enumerate(stages) if stage != WAKE]
    stretches: list[tuple[int, int]] = []
    begin = None
    for k in range(asleep[0], asleep[-1] + 1) if asleep else ():
        if stages[k] == WAKE and begin is None:
            begin = k
        if stages[k] != WAKE and begin is not None:
            stretches.append((begin, k))
            begin = None
    longest = sorted(stretches, key=lambda s: s[0] - s[1])[:count]
    away = []
    for first, stop in sorted(longest):
        if stop - first >= 6:
            leave = bed_s + (first + 1) * EPOCH_S + float(random.uniform(0, 20))
            most = (stop - 1) * EPOCH_S + bed_s - leave - RISE_S
            away.append((leave, leave + min(most, float(random.uniform(100, 400)))))
    return away


def _movements(stages: Sequence[str], bed_s: float, random: np.random.Generator) -> list[Act]:
    """Restless wake, still wake, twitches of sleep, and turns."""
    acts: list[Act] = []
    limbs = ("left arm", "right arm", "left leg", "right leg", "head")
    still = False
    for k, stage in enumerate(stages):
        if k % 10 == 0:
            still = bool(random.random() < STILL_WAKE)
        moving = random.random() < MOVES[stage] and not (stage == WAKE and still)
        for _ in range(int(random.integers(1, 4)) if moving and stage == WAKE else int(moving)):
            onset = bed_s + k * EPOCH_S + float(random.uniform(0, 24))
            turn = random.random() < 0.25
            duration = float(random.uniform(3, 6)) if turn else float(random.uniform(1.5, 5))
            acts.append(
                Act(onset, duration, "turn" if turn else str(random.choice(limbs)), float(random.uniform(40, 140)))
            )
    return acts
