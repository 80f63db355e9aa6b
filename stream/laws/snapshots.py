"""All that a trial holds: every check, then random tries, the first failure made as simple as it goes."""

from __future__ import annotations

from collections.abc import Callable

from kinegraph.stream.laws.checks import checks
from kinegraph.stream.laws.laws import Conformance
from kinegraph.stream.laws.random_cases import Choices, smallest
from kinegraph.stream.laws.violations import Broken


def hold(trial: Conformance, examples: int, seed: int, done: Callable[[bool], None] = lambda failed: None) -> None:
    """Hold one case to the laws; raises Broken. `done` is called after each check and try, with True before a failure is made simpler."""
    for check in checks(trial).values():
        check()
        done(False)
    for k in range(examples):
        choices = Choices(seed * 1_000_003 + k)
        try:
            trial.attempt(choices)
        except Broken as broken:
            done(True)
            raise smallest(trial.attempt, choices, broken) from None
        done(False)
