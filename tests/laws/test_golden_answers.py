"""Golden answers: operators, commands and graphs answer what tests/laws/golden shows.

Where a change is meant: `python -m tests.golden Envelope --write`, and say in the commit what changed and why.
"""

from __future__ import annotations

import pytest

from tests.golden import ANSWERS, MAX_BYTES, MAX_LINES, alike, answer, differences, operators, read
from tests.golden_commands import RELATIVE, scenes
from tests.golden_commands import answer as printed
from tests.golden_graphs import answer as replayed
from tests.golden_graphs import graphs

OPERATORS, SCENES, GRAPHS = operators(), scenes(), graphs()


@pytest.mark.parametrize("use", OPERATORS)
def test_an_operator_answers_as_it_did(use: str) -> None:
    assert not differences(read(OPERATORS[use]), answer(use))


@pytest.mark.parametrize("name", SCENES)
def test_a_command_prints_what_it_did(name: str) -> None:
    assert not differences(read(SCENES[name]), printed(name), RELATIVE)


@pytest.mark.parametrize("name", GRAPHS)
def test_a_graph_answers_as_it_did_on_a_simulated_walk(name: str) -> None:
    assert not differences(read(GRAPHS[name]), replayed(name))


def test_golden_answers_are_short_enough_to_be_reviewed() -> None:
    texts = {path: read(path) for path in ANSWERS.rglob("*.*")}
    assert texts.keys() == {*OPERATORS.values(), *SCENES.values(), *GRAPHS.values()}
    assert not [path.name for path, text in texts.items() if text.count("\n") > MAX_LINES]
    assert sum(len(text.encode()) for text in texts.values()) <= MAX_BYTES


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("0.250000  1.2041  good", "0.250001   1.2042  good", True),
        ("0.250000  1.2041  good", "0.250000  1.2043  good", False),
        ("0.250000  1.2041  good", "0.250000  1.2041  bad", False),
        ("0.250000  1.2041", "0.250000  -1.2041", False),
        ("in: 20 samples", "in: 21 samples", False),
        ("1.2041e+09", "1.2042e+09", True),
        ("b.mcap + 7.5 s", "b.mcap - 7.5 s", False),
        ("-", "nan", False),
    ],
)
def test_words_and_whole_numbers_must_be_the_same_and_others_to_the_last_place(
    one: str, other: str, same: bool
) -> None:
    assert alike(one, other) == same
