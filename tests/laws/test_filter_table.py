"""The docs' table of filters says what the filters declare."""

from __future__ import annotations

from tests.filter_table import PAGE, page, table


def test_the_table_of_filters_is_what_they_declare() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "run: python -m tests.filter_table"


def test_each_filter_says_what_it_does_to_time() -> None:
    rows = [line.split(" | ") for line in table().splitlines()[2:]]
    assert len(rows) >= 18 and all(len(row) == 4 for row in rows)
    assert [row[0] for row in rows if not row[2].strip()] == []
