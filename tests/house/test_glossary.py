"""The words: a term is defined once, what it names in the code is there, and no other name for it stands in the docs."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = ROOT / "docs" / "use" / "glossary.md"
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
ROW = re.compile(r"^\| (?!term|---)(.+?) \| (.+?) \| (.+?) \|$", re.MULTILINE)
OTHER_NAMES = re.compile(
    r"\b(doorbells?|bell|intakes?|tapes?|scribes?|fasten(s|ed)?|loosen(s|ed)?|taps?|desks?|letter|outbox(es)?|brains?|lanes?|journals?"
    r"|shel(f|ves)|tally|tallies|tallied)\b",
    re.IGNORECASE,
)
"""Names that engine things had before they had those of the glossary."""
SHOWN = {"CHANGELOG.md": {"lane", "bell"}, "segmentation.md": {"bell"}, "segmentation-figures.md": {"bell"}}
"""Where an old name is what the page is about (how to rename it), or where it means what it says: a bell that rings."""
TRANSLATED = re.compile(
    r"\b(hangs? (on|out)|anew|(is|are) told|tells? of|so many|so much|so often|stands? in for|the house|amount of the)\b",
    re.IGNORECASE,
)
"""Phrases that no native speaker writes in a manual."""
NAMES = re.compile(r"`[^`\n]*`")
"""What is quoted from the code is no prose."""


def rows() -> list[tuple[str, str, str]]:
    return ROW.findall(GLOSSARY.read_text(encoding="utf-8"))


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def test_a_term_is_defined_once() -> None:
    terms = Counter(term for term, _, _ in rows())
    assert len(terms) > 40
    assert [term for term, n in terms.items() if n > 1] == []


def test_what_the_glossary_names_in_the_code_is_there() -> None:
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "stream").rglob("*.py"))
    for term, meaning, _ in rows():
        for name in re.findall(r"`([A-Z]\w+|stream/[\w/.]+)`", meaning):
            if "/" in name:
                assert (ROOT / name).exists(), f"{term}: there is no {name}"
            else:
                assert re.search(rf"^(class {name}\b|{name}\b.*=)", code, re.MULTILINE), (
                    f"{term}: nothing is called {name}"
                )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_no_other_name_stands_in_the_docs(page: Path) -> None:
    found = {match.group().lower() for match in OTHER_NAMES.finditer(prose(page))}
    assert found <= SHOWN.get(page.name, set())


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_a_page_is_native_english(page: Path) -> None:
    assert [match.group() for match in TRANSLATED.finditer(prose(page))] == []


@pytest.mark.parametrize("package", ["stream", "devices", "operators"])
def test_docstrings_and_messages_are_native_english(package: str) -> None:
    found = []
    for path in sorted((ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = NAMES.sub("", node.value)
                found += [f"{path.relative_to(ROOT)}:{node.lineno}: {m.group()}" for m in TRANSLATED.finditer(text)]
    assert found == []


@pytest.mark.parametrize("page", ["README.md", "docs/use/graphs.md"])
def test_the_glossary_is_found(page: str) -> None:
    assert "glossary.md" in (ROOT / page).read_text(encoding="utf-8")
