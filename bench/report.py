"""What a measure gives back, and how it is shown: goals, reached or not, and all tables, in a page of the docs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

HOUSE = Path(__file__).resolve().parent.parent
BEGIN = "<!-- bench: begin (written by `make bench`) -->"
END = "<!-- bench: end -->"


def marks(name: str) -> tuple[str, str]:
    """Where a bench of its own, `python -m NAME`, writes its report into a page."""
    return f"<!-- {name}: begin (written by `python -m {name} --write`) -->", f"<!-- {name}: end -->"


@dataclass(slots=True)
class Goal:
    """One promise: what was reached, and the most (or, with `least`, the least) that it may be."""

    name: str
    reached: float
    limit: float
    unit: str
    least: bool = False

    @property
    def met(self) -> bool:
        return self.reached >= self.limit if self.least else self.reached <= self.limit

    def row(self) -> list[str]:
        bound = f"{'at least' if self.least else 'at most'} {self.limit:g} {self.unit}"
        return [self.name, f"{short(self.reached)} {self.unit}".strip(), bound.strip(), "yes" if self.met else "**no**"]


@dataclass(slots=True)
class Section:
    """A table with a heading and notes."""

    title: str
    header: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    goals: list[Goal] = field(default_factory=list)

    def markdown(self) -> str:
        return "\n\n".join([f"**{self.title}**", *([table(self.header, self.rows)] if self.rows else []), *self.notes])


def table(header: list[str], rows: list[list[str]]) -> str:
    """A Markdown table; every column but the first is set flush right."""
    lines = ["| " + " | ".join(header) + " |", "|" + "|".join(["---", *["--:"] * (len(header) - 1)]) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def short(value: float) -> str:
    """Three significant digits, without an exponent."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def goals(sections: list[Section], about: str) -> str:
    """What was promised, and what was reached."""
    rows = [goal.row() for section in sections for goal in section.goals]
    return "\n\n".join([about, *([table(["goal", "reached", "promised", "kept"], rows)] if rows else [])])


def tables(sections: list[Section]) -> str:
    """All tables, one below the other."""
    return "\n\n".join(section.markdown() for section in sections)


def whole(sections: list[Section], about: str) -> str:
    """The whole report: goals, then tables."""
    return f"{goals(sections, about)}\n\n{tables(sections)}"


def publish(sections: list[Section], about: str, page: str, begin: str = BEGIN, end: str = END) -> None:
    """Write goals and tables into a page of the docs."""
    into_page(HOUSE / "docs" / page, whole(sections, about), begin, end)


def into_page(page: Path, text: str, begin: str = BEGIN, end: str = END) -> None:
    """Put the report between its marks; at the end, if the marks are missing."""
    before = page.read_text(encoding="utf-8")
    block = f"{begin}\n{text}\n{end}"
    if begin in before and end in before:
        head, _, rest = before.partition(begin)
        after = head + block + rest.partition(end)[2]
    else:
        after = f"{before.rstrip()}\n\n## Speed\n\n{block}\n"
    page.write_text(after, encoding="utf-8")
