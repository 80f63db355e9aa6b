"""Remembered designs come back bit for bit, for the same arguments only, whatever happens to the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import Samples
from kinegraph.stream.data import design_cache as module
from kinegraph.stream.data.design_cache import remembered


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(module, "_folder", lambda: tmp_path)
    return tmp_path


def test_arrays_numbers_and_tuples_come_back_bit_for_bit(folder: Path) -> None:
    calls = []

    @remembered
    def design(order: int, cutoff_hz: float, start: Samples) -> tuple[Samples, float, int]:
        calls.append(order)
        return np.sin(start * cutoff_hz), 0.1 + cutoff_hz, order

    @remembered
    def reach(order: int) -> int:
        return order + 1

    start = np.linspace(0, 1, 7)
    for order, cutoff_hz in ((2, 0.3), (2, 0.30000000000000004), (3, 0.3)):
        first, again = design(order, cutoff_hz, start), design(order, cutoff_hz, start.copy())
        assert first[0].tobytes() == again[0].tobytes()
        assert first[1:] == again[1:]
        assert [type(part) for part in first] == [type(part) for part in again]
    assert calls == [2, 2, 3]
    design(2, 0.3, start + 1)
    assert calls == [2, 2, 3, 2]
    assert [reach(4), reach(4)] == [5, 5]


def test_two_processes_that_keep_the_same_do_not_write_into_one_draft(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drafts, save = set[str](), np.savez

    def saved(file: Any, **parts: Any) -> None:
        drafts.add(file.name)
        save(file, **parts)

    monkeypatch.setattr(np, "savez", saved)
    for pid in (41, 42):
        with monkeypatch.context() as process:
            process.setattr("os.getpid", lambda pid=pid: pid)
            module._keep(folder / "one.npz", np.arange(3.0))
    assert len(drafts) == 2
    assert [path.name for path in folder.iterdir()] == ["one.npz"]


def test_a_damaged_file_is_made_again(folder: Path) -> None:
    @remembered
    def design(order: int) -> Samples:
        return np.arange(float(order))

    design(5)
    (path,) = folder.iterdir()
    for content in (b"", b"PK nonsense", path.read_bytes()[:40]):
        path.write_bytes(content)
        assert np.array_equal(design(5), np.arange(5.0))
        assert np.array_equal(design(5), np.arange(5.0))
    assert len(list(folder.iterdir())) == 1


def test_a_folder_that_cannot_be_written_is_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_folder", lambda: tmp_path / "missing")

    @remembered
    def design(order: int) -> Samples:
        return np.arange(float(order))

    assert np.array_equal(design(3), np.arange(3.0))


def test_a_wrong_argument_is_told_every_time(folder: Path) -> None:
    @remembered
    def design(order: int) -> Samples:
        raise ValueError("order must be positive")

    for _ in range(2):
        with pytest.raises(ValueError, match="positive"):
            design(0)
    assert not list(folder.iterdir())
