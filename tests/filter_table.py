"""`python -m tests.filter_table`: write the table of filters in docs/method/filters.md from what they declare; a test compares."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.operator import Operator

PAGE = Path(__file__).resolve().parent.parent / "docs" / "method" / "filters.md"
HEAD = "| operator | what it does | delay | equal to, or source |\n|---|---|---|---|\n"


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
    # the first clause: `kinegraph components NAME` has the rest
    cells = (f"`{name}`", re.split(r"[.;:](?= |$)", text)[0], part.delays, part.references)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def page(text: str) -> str:
    """The page with the table as it should be."""
    start = text.index(HEAD)
    return text[:start] + table() + text[text.index("\n\n", start) + 1 :]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
