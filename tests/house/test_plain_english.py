"""Plain English: words of the old dialect stay rare in code and docs."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("stream", "devices", "operators", "configs", "bench", "tests", "docs", "kinegraph")
TEXTS = {".py", ".md", ".ts", ".yaml", ".html", ".j2", ".txt", ".ipynb"}
FOREIGN = ("tests/recordings/", "tests/files/real/", "devices/page/built/", "tests/house/test_plain_english.py")
"""Data and code that others wrote, and this file, which has to name the words."""
WORD = re.compile(r"\b(?:told|said|none|whose|nobody)\b", re.IGNORECASE)
NOT_PROSE = re.compile(r"\bNone\b|([\"'`])none\1|\bst\.none\(")
"""Python's None, a setting's value "none", and Hypothesis' strategy."""
MOST = 500


def occurrences(path: Path) -> int:
    """How often the words occur in a file, leaving out what is no prose."""
    return len(WORD.findall(NOT_PROSE.sub("", path.read_text(encoding="utf-8"))))


def test_words_of_the_old_dialect_are_rare() -> None:
    names = [
        path.relative_to(ROOT) for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in TEXTS
    ]
    kept = [name for name in names if not name.as_posix().startswith(FOREIGN) and "node_modules" not in name.parts]
    counts = {name.as_posix(): occurrences(ROOT / name) for name in kept}
    total = sum(counts.values())
    worst = sorted(counts.items(), key=lambda item: -item[1])[:10]
    assert total <= MOST, f"told, said, none, whose and nobody occur {total} times, most often in {worst}"
