"""Golden answers of commands: what they print and write, on made-up recordings, is what is kept in tests/laws/golden/commands.

Where a change is meant: `python -m tests.golden_commands --write train-steering`, and say in the commit what changed and why.
"""

from __future__ import annotations

import pytest

from tests.golden_commands import ANSWERS, SCENES, alike, answers, changes, read


@pytest.mark.parametrize("name", list(SCENES))
def test_it_answers_as_it_did(name: str) -> None:
    told = changes(read(name), answers(name))
    assert not told, "\n".join([f"{len(told)} answers of {name} changed:", *told[:10]])


def test_what_is_kept_is_of_commands_that_are_asked() -> None:
    assert sorted(path.stem for path in ANSWERS.glob("*.txt")) == sorted(SCENES)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("TA: divergence 0.117, nowhere", "TA: divergence 0.118, nowhere", True),
        ("TA: divergence 0.117, nowhere", "TA: divergence 0.119, nowhere", False),
        ("TA: divergence 0.117, nowhere", "SO: divergence 0.117, nowhere", False),
        ("20 cycles of 2 sessions", "21 cycles of 2 sessions", False),
        ("b.mcap + 7.5 s", "b.mcap - 7.5 s", False),
        ("b.mcap +7.500012 s", "b.mcap +7.500013 s", True),
        ("words=#17 numbers=0,100,500", "words=#17 numbers=0,100.1,500.1", True),
        ("words=#17 numbers=0,100,500", "words=#18 numbers=0,100,500", False),
        ("words=#17 numbers=0,100,500", "words=#17 numbers=0,100,501", False),
    ],
)
def test_words_must_be_the_same_and_numbers_near(one: str, other: str, same: bool) -> None:
    assert alike(one, other) == same
