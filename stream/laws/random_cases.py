"""Chance that can be repeated and made smaller: what was drawn is kept as numbers, and the simplest that still fails is looked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

from kinegraph.stream.laws.case_samples import Draw
from kinegraph.stream.laws.violations import Broken


class Choices:
    """Draws by chance from a seed, or what is given (and the least once that is used up); `drawn` is what came."""

    def __init__(self, seed: int | None = None, given: Sequence[int] = ()) -> None:
        self._random = None if seed is None else Random(seed)
        self._given = iter(given)
        self.drawn: list[int] = []
        self.least: list[int] = []

    def __call__(self, least: int, most: int) -> int:
        value = self._random.randint(least, most) if self._random else min(max(next(self._given, least), least), most)
        self.drawn.append(value)
        self.least.append(least)
        return value


def smallest(attempt: Callable[[Draw], None], choices: Choices, broken: Broken, tries: int = 300) -> Broken:
    """Make what broke a rule simpler, choice by choice, as long as it breaks the same one. Returns the simplest complaint found."""
    best, known = choices, broken
    step = len(best.drawn)
    while step and tries > 0:
        k, shorter = 0, False
        while k < len(best.drawn) and tries > 0:
            simpler = [*best.drawn[:k], *best.least[k : k + step], *best.drawn[k + step :]]
            tries -= 1
            found = None if simpler == best.drawn else _complaint(attempt, again := Choices(given=simpler))
            if found is not None and found.rule == known.rule:
                best, known, shorter = again, found, True
            k += step
        step = step if shorter else step // 2
    return known


def _complaint(attempt: Callable[[Draw], None], choices: Choices) -> Broken | None:
    try:
        attempt(choices)
    except Broken as broken:
        return broken
    return None
