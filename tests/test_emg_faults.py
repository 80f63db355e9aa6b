"""The table of faults in docs/emg.md: all that the bench makes, none that changes a number by more than a tenth in silence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bench.emg_faults import FAULTS, table

PAGE = Path(__file__).resolve().parent.parent / "docs" / "emg.md"
ROW = re.compile(r"^\| (.+?) \| (.+?) \| (.+?) \| (\S+ %|no curve) \| (\S+ %|no curve) \| (\d+) \|$", re.MULTILINE)


def in_silence(noticed: str, *changes: str) -> bool:
    """Whether a change of more than 10 % goes without an alarm and without a verdict."""
    large = any(change == "no curve" or abs(float(change.removesuffix(" %"))) > 10 for change in changes)
    return large and noticed == "not"


def test_the_table_has_every_fault_and_none_goes_in_silence() -> None:
    rows = {row[0]: row for row in ROW.findall(PAGE.read_text(encoding="utf-8"))}
    assert list(rows) == ["none", *FAULTS] and len(FAULTS) >= 30
    assert [name for name, noticed, _, *changes, _ in rows.values() if in_silence(noticed, *changes)] == []
    assert f"puts {len(FAULTS)} faults" in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["electrode off (flat)", "TA's gain doubled", "plate drifts 60 N"])
def test_a_fault_is_noticed_as_the_table_says(name: str) -> None:
    (expected,) = [row for row in ROW.findall(PAGE.read_text(encoding="utf-8")) if row[0] == name]
    _, made = table([name])
    assert [str(cell) for cell in made[:3]] == list(expected[:3]) and str(made[5]) == expected[5]
    assert not in_silence(made[1], made[3], made[4])
