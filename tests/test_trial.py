"""The trial itself: operators that break one law each are caught for that law, and a sound one passes."""

from __future__ import annotations

from typing import Any

import pytest
from broken_operators import Excused, Sound, all_broken

from stream.operator import Operator
from stream.trial import RULES, Broken, Choices, checks, smallest, trials

SEEDS = range(30)


def complaint(cls: type[Operator[Any]]) -> Broken | None:
    """What is wrong with an operator, if anything."""
    try:
        for make in trials(cls):
            trial = make()
            for check in checks(trial).values():
                check()
            for seed in SEEDS:
                trial.attempt(choices := Choices(seed))
    except Broken as broken:
        return smallest(trial.attempt, choices, broken) if "choices" in locals() else broken
    return None


@pytest.mark.parametrize(("cls", "rule"), all_broken().items(), ids=[c.__name__ for c in all_broken()])
def test_a_broken_operator_is_caught_for_what_it_breaks(cls: type[Operator[Any]], rule: str) -> None:
    broken = complaint(cls)
    assert broken is not None, f"{cls.__name__} was not caught"
    assert broken.rule == rule, str(broken)
    assert RULES[rule].advice in str(broken)


@pytest.mark.parametrize("cls", [Sound, Excused])
def test_a_sound_operator_passes(cls: type[Operator[Any]]) -> None:
    assert complaint(cls) is None


def test_every_rule_has_an_operator_that_breaks_it() -> None:
    assert set(all_broken().values()) == set(RULES)
