"""The rules that operators are tried by bear the numbers of the laws in docs/extend/operator.md."""

from __future__ import annotations

import re

from kinegraph.stream.laws.violations import RULES
from tests.public_names import HOUSE


def test_the_page_has_seven_laws_and_every_rule_is_one_of_them_or_comes_before() -> None:
    page = (HOUSE / "docs" / "extend" / "operator.md").read_text(encoding="utf-8")
    laws = [int(number) for number in re.findall(r"^\| (\d) \| .+? \|", page, re.MULTILINE)]
    assert sorted(laws) == [1, 2, 3, 4, 5, 6, 7]
    assert {rule.law for rule in RULES.values()} == {0, *laws}
