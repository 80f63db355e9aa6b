"""`python -m tests.filter_table`: write the table of filters in docs/method/filters.md from what they declare; a test compares."""

from __future__ import annotations

import re
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.operator import Operator

PAGE = Path(__file__).resolve().parent.parent / "docs" / "method" / "filters.md"
HEAD = "| operator | what it does | parameters | delay | equal to, or source |\n|---|---|---|---|---|\n"
USUAL = {"reset_gap_s": 0.1}
"""What most have; told where it differs."""


def table() -> str:
    """One row for each operator in operators/filters and operators/timing, in the order of their names."""
    found = {
        use: part
        for use, part in catalogue(("operators",))[0].items()
        if part.__module__.split(".")[2] in ("filters", "timing")
    }
    return HEAD + "".join(_row(use.removeprefix("operators."), part) for use, part in sorted(found.items()))


def _row(name: str, part: type[Operator[Any]]) -> str:
    text = " ".join((part.__doc__ or "").split("\n\n")[0].split())
    cells = (f"`{name}`", re.split(r"\.(?= [A-Z]|$)", text)[0], _parameters(part), part.delays, part.references)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _parameters(part: type[Operator[Any]]) -> str:
    rows = []
    for f in fields(part):  # type: ignore[arg-type]
        if f.name not in USUAL or f.default != USUAL[f.name]:
            default = "" if f.default in (MISSING, None, (), "") else f" {_plain(f.default)}"
            rows.append(f"`{f.name}`{default}")
    return ", ".join(rows)


def _plain(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def page(text: str) -> str:
    """The page with the table as it should be."""
    start = text.index(HEAD)
    return text[:start] + table() + text[text.index("\n\n", start) + 1 :]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
