"""Golden answers: on its cases, on faults, with other parameters and streams, every operator gives what is kept in tests/laws/golden.

Where a change is meant: `python -m tests.golden --write gait`, and say in the commit what changed and why.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from stream.graph.parts import catalogue
from tests import golden
from tests.golden import ANSWERS, alike, changes, changing, given, read, write

MOST = 5
KEPT = sorted(path.stem for path in ANSWERS.glob("*.txt"))


@pytest.mark.parametrize("use", KEPT)
def test_it_answers_as_it_did(use: str) -> None:
    """Nothing more is asked once some answers have changed."""
    told = [*islice(changing(read(use), given(use)), MOST)]
    assert not told, "\n".join([f"answers of {use} changed (the first {MOST} at most):", *told])


def test_every_operator_has_golden_answers() -> None:
    assert sorted(catalogue(("operators",))[0]) == KEPT


def test_what_is_kept_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(golden, "ANSWERS", tmp_path)
    found = {"0 plain out": "n=3 " + "x" * 80, "0 window_s=2.0 out": "n=3 " + "x" * 80, "0 window_s?-1": "is accepted"}
    write("operators.Some", found)
    assert read("operators.Some") == found
    assert (tmp_path / "operators.Some.txt").read_text(encoding="utf-8").count("xxx") < 40


def test_sums_know_each_number_its_place_and_its_channel() -> None:
    rng = np.random.default_rng(1)
    data = rng.standard_normal((500, 3))

    def told(array: np.ndarray) -> str:
        return " ".join(f"{name}={golden._sums(column)}" for name, column in golden._columns(array))

    first = told(data)
    rounded = data * (1 + 1e-9)
    swapped = data.copy()
    swapped[[100, 101]] = data[[101, 100]]
    nudged = data.copy()
    nudged[321, 1] *= 1.01
    missing = data.copy()
    missing[7, 2] = np.nan
    assert alike(first, told(rounded))
    for other in (swapped, nudged, missing, -data, data[:, [1, 0, 2]], data[:-1], np.roll(data, 1, axis=0)):
        assert not alike(first, told(other))


def test_other_words_and_other_counts_are_changes() -> None:
    assert changes({"0 a": "n=3 lost=0/0"}, {"0 a": "n=4 lost=0/0"}) == ["0 a: n=3 was, n=4 is"]
    assert changes({"0 a?-1": "is accepted"}, {}) == ["0 a?-1: is accepted -- was, is -- nothing"]
    assert not changes({"0 a": "v=0,1.00000001,2"}, {"0 a": "v=0,1.00000002,2"})
