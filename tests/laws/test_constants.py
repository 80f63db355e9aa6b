"""Numbers that modules declare are those that were kept: `python -m tests.constants --write` after a change on purpose."""

from __future__ import annotations

import subprocess
import sys

from tests.constants import HOUSE, declared, modules


def test_modules_declare_what_they_did() -> None:
    """In a process of its own, where no other test has touched a module."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.constants"], cwd=HOUSE, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{done.stdout}{done.stderr}\nif that is meant: python -m tests.constants --write"


def test_numbers_are_told_apart_and_words_are_not() -> None:
    found = declared("operators.gait.textbook")
    assert found["SOFT"] == "10"
    assert len(found["WORKS_PCT"]) == 16
    assert "_SIDES" not in found
    assert declared("tests.laws.test_constants") == {}
    assert "operators.gait.textbook" in modules()
