"""The plane of a mattress is found however the camera is tilted."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.mattress import mattress, somebody


@pytest.mark.parametrize(("down", "right"), [(0.0, 0.0), (4e-6, 0.0), (0.0, 6e-6), (-3e-6, 5e-6), (2e-6, -7e-6)])
def test_the_plane_is_that_of_the_mattress_whoever_lies_on_it(down: float, right: float) -> None:
    rows, columns = np.mgrid[:12, :9]
    true = 1 / (1 / 2000.0 + down * rows + right * columns)
    seen = true.copy()
    seen[3:8, 3:6] -= 180.0
    seen[0, 0] = np.nan
    assert np.abs(mattress(seen, 15.0) - true).max() < 1.0


@pytest.mark.parametrize("floor", [1, 2, 3, 4])
def test_floor_beside_the_bed_is_not_taken_for_it_if_it_is_half_as_much(floor: int) -> None:
    """Of 12 columns `floor` show the floor, 600 mm below; the bed is at least twice as much."""
    rows, columns = np.mgrid[:10, :12]
    bed = 1 / (1 / 2000.0 + 3e-6 * rows + 2e-6 * columns)
    seen = np.where(columns < floor, bed + 600.0, bed)
    assert np.abs(mattress(seen, 15.0) - bed).max() < 1.0


def test_what_lies_flat_on_half_of_the_bed_is_not_taken_for_it() -> None:
    rows, columns = np.mgrid[:12, :10]
    bed = 1 / (1 / 2000.0 + 3e-6 * rows + 0.0 * columns)
    seen = np.where((rows < 10) & (columns < 6), bed - 250.0, bed)
    assert np.abs(mattress(seen, 15.0) - bed).max() < 1.0


@pytest.mark.parametrize(("rows", "columns"), [(10, 6), (10, 10), (6, 40)])
def test_somebody_lies_across_the_middle_of_the_length_and_is_no_wall(rows: int, columns: int) -> None:
    """The length is that of the picture's columns, but in a bed that is much wider than long."""
    long, flat = max(rows, columns) if columns > 2 * rows else rows, np.zeros((rows, columns))
    at = flat.T if columns > 2 * rows else flat

    def lies(first: float, last: float, high: float, share: float = 1.0) -> bool:
        at[:] = 0.0
        at[round(first * long) : round(last * long), : round(share * at.shape[1])] = high
        return somebody(flat, 60.0, 0.25)

    assert lies(0.1, 0.9, 200.0) and lies(0.1, 0.9, 200.0, share=0.5)
    assert not lies(0.0, 0.4, 200.0), "pillows"
    assert not lies(0.6, 1.0, 200.0), "a folded blanket"
    assert not lies(0.1, 0.9, 50.0), "no higher than the mattress is uneven"
    assert not lies(0.1, 0.9, 500.0), "a bed in a region of floor"
    assert not lies(0.1, 0.9, 200.0, share=0.1), "an arm's breadth"
