"""The tables of faults in docs/lab/emg.md: all that the benches make; no fault silently changes a number by more than a tenth."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bench import emg_faults, emg_real_faults
from tests.support.real import needs_data

PAGE = Path(__file__).resolve().parents[2] / "docs" / "lab" / "emg.md"
CELL = r" ([^|]+?) \|"
ROW = re.compile(rf"^\|{8 * CELL}$", re.MULTILINE)
REAL = {**emg_real_faults.FAULTS, **emg_real_faults.OVERGROUND}


def tables() -> list[dict[str, tuple[str, ...]]]:
    """The rows of the simulated walk, and those of the real ones, by name."""
    rows = [row for row in ROW.findall(PAGE.read_text(encoding="utf-8")) if row[0] != "fault" and row[0] != "---"]
    second = [i for i, row in enumerate(rows) if row[0] == "none"][1]
    return [{row[0]: row for row in part} for part in (rows[:second], rows[second:])]


def in_silence(row: tuple[str, ...]) -> bool:
    """Whether a change of more than 10 % goes without an alarm and without a verdict."""
    changes = [re.search(r"\(([-+]\d+) %\)", cell) for cell in row[5:7]]
    return row[1] == "not" and any(found is None or abs(int(found[1])) > 10 for found in changes)


def test_the_tables_have_every_fault_and_none_goes_in_silence() -> None:
    simulated, real = tables()
    assert list(simulated) == ["none", *emg_faults.FAULTS] and len(emg_faults.FAULTS) >= 30
    both = ["none", *emg_real_faults.FAULTS, "overground: none", *emg_real_faults.OVERGROUND]
    assert list(real) == both and len(REAL) >= 30
    assert [name for rows in (simulated, real) for name, row in rows.items() if in_silence(row)] == []
    page = PAGE.read_text(encoding="utf-8")
    assert f"puts {len(emg_faults.FAULTS)} faults" in page and f"{len(REAL)} into recordings of real walks" in page


@pytest.mark.parametrize("name", ["electrode off (flat)", "TA's gain doubled", "plate drifts 60 N"])
def test_a_fault_is_noticed_as_the_table_says(name: str) -> None:
    _, made = emg_faults.table([name])
    assert made == tables()[0][name] and not in_silence(made)


@needs_data
@pytest.mark.parametrize(
    "name", ["electrode off (flat)", "one touch-down in ten missed", "overground: toe's marker stands still"]
)
def test_a_fault_in_a_real_walk_is_noticed_as_the_table_says(name: str) -> None:
    _, made = emg_real_faults.table([name])
    assert made == tables()[1][name] and not in_silence(made)
