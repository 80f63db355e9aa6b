"""What is raised apart from the sleeper: pieces that touch, and the largest of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from kinegraph.operators.bed.visitor import apart


@pytest.mark.parametrize("seed", range(12))
def test_pieces_are_those_of_scipy_and_the_largest_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(1, 14, 2)
    raised = (rng.random((rows, columns)) < rng.choice([0.0, 0.2, 0.45, 0.7, 1.0])).astype(np.int64)
    label, stack = np.full((rows, columns), 7, np.int64), np.empty(rows * columns, np.int64)
    largest = apart(raised, label, stack)
    true, count = ndimage.label(raised, np.ones((3, 3)))
    assert np.array_equal(label, true)
    sizes = np.bincount(true.ravel(), minlength=count + 1)[1:]
    assert largest == (int(sizes.argmax()) + 1 if count else 0)


def test_of_two_equal_pieces_and_of_single_blocks_the_first_is_the_largest() -> None:
    for size in (1, 2, 3):
        raised = np.zeros((5, 7), np.int64)
        raised[1, :size] = raised[3, :size] = 1
        label, stack = np.zeros_like(raised), np.empty(raised.size, np.int64)
        assert apart(raised, label, stack) == 1
        raised[4, : size + 1] = 1
        assert apart(raised, label, stack) == 2
