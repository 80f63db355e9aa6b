"""A record is one argument of kernels: arrays and numbers by name, shared with Python, and no reference is kept."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.kernel import kernel


class Numbers:
    count: int
    is_over: bool
    scale: float


NUMBERS = numbers_of(Numbers)


@record
@dataclass
class Sums(Numbers):
    numbers: Any
    totals: Any
    rows: Any


@kernel
def add_row(s: Sums, i: int) -> float:
    for k in range(s.totals.shape[0]):
        s.totals[k] += s.rows[i, k] * s.scale
    s.count += 1
    s.is_over = s.count >= 2
    return float(s.totals[-1])


@kernel
def add_rows(s: Sums) -> float:
    last = 0.0
    for i in range(s.rows.shape[0]):
        last = add_row(s, i)
    return last


def sums() -> Sums:
    made = Sums(np.zeros((), NUMBERS), np.zeros(3), np.arange(6.0).reshape(2, 3))
    made.scale = 2.0
    return made


def test_kernels_and_python_read_and_write_the_same_arrays_and_numbers() -> None:
    s = sums()
    assert add_row(s, 1) == 10.0
    assert (s.count, s.is_over, s.totals.tolist()) == (1, False, [6.0, 8.0, 10.0])
    s.scale = 1.0
    assert add_rows(s) == 17.0, "a kernel that is called by another"
    assert (s.count, s.is_over) == (3, True)


def test_no_reference_to_an_array_is_kept() -> None:
    s = sums()
    before = [sys.getrefcount(array) for array in (s.numbers, s.totals, s.rows)]
    for _ in range(10):
        add_row(s, 0)
    assert [sys.getrefcount(array) for array in (s.numbers, s.totals, s.rows)] == before


def test_arrays_of_another_kind_are_refused() -> None:
    add_row(sums(), 0)
    s = sums()
    s.totals = np.zeros(3, np.float32)
    with pytest.raises(TypeError, match="not those that it was compiled for"):
        add_row(s, 0)
