"""The rules that operators are tried by bear the numbers of the laws in docs/operators.md."""

from __future__ import annotations

import re

import pytest

from stream.conformance.broken import RULES
from tests.public_names import HOUSE

WORDS = {
    "cuts": "cutting", "ties": "cutting", "replay": "same output", "step": "same output", "state": "snapshot",
    "memory": "stops growing",
    **dict.fromkeys(("spec", "order", "spacing", "until", "delay", "time"), "promised"),
    **dict.fromkeys(("channels", "nan", "poison", "infinity", "gaps", "reset", "settling"), "Bad samples"),
    **dict.fromkeys(("arrays", "emitted", "inputs", "compile"), "stalls"),
}  # fmt: skip
"""What the law of a rule says in the table."""


def laws() -> dict[int, str]:
    page = (HOUSE / "docs" / "operators.md").read_text(encoding="utf-8")
    return {int(number): said for number, said in re.findall(r"^\| (\d) \| (.+?) \|", page, re.MULTILINE)}


def test_the_page_has_seven_laws_and_every_rule_is_one_of_them_or_comes_before() -> None:
    assert sorted(laws()) == [1, 2, 3, 4, 5, 6, 7]
    assert {rule.law for rule in RULES.values()} == {0, *laws()}


@pytest.mark.parametrize("name", RULES)
def test_a_rule_bears_the_number_of_its_law(name: str) -> None:
    law = RULES[name].law
    assert WORDS[name] in laws()[law] if name in WORDS else law == 0
