"""Seconds of depth against numpy, block by block; and the room's reference where a block is not measured any more."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.frames.seconds import add, close, look
from kinegraph.operators.bed.frames.view import RECENT, View
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import grid


@pytest.mark.parametrize("seen", [0.1, 0.4, 1.0])
def test_a_seconds_mean_and_its_stretch_are_numpys(seen: float) -> None:
    rng = np.random.default_rng(6)
    sums, counts, mean, stretch = np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((3, 4, 6))
    means = []
    for _ in range(7):
        frames = np.where(
            rng.random((5, 4, 6)) < seen, rng.normal(2000.0, 50.0, (5, 4, 6)), rng.choice([np.nan, np.inf])
        )
        for frame in frames:
            add(frame, sums, counts)
        close(sums, counts, mean, stretch)
        there = [[[v for v in frames[:, r, c] if np.isfinite(v)] for c in range(6)] for r in range(4)]
        means.append([[sum(v) / len(v) if v else np.nan for v in row] for row in there])
        np.testing.assert_allclose(mean, means[-1], rtol=1e-12)
        assert not sums.any() and not counts.any()
    every = np.array(means)
    np.testing.assert_allclose(stretch[0], np.isfinite(every).sum(axis=0))
    np.testing.assert_allclose(stretch[1], np.nansum(every, axis=0), rtol=1e-12)
    np.testing.assert_allclose(stretch[2], np.nansum(every**2, axis=0), rtol=1e-12)


def test_what_is_raised_in_a_region_is_counted_block_by_block() -> None:
    rng = np.random.default_rng(7)
    empty = np.where(rng.random((6, 8)) < 0.8, 2000.0, np.nan)
    mean = np.where(rng.random((6, 8)) < 0.8, rng.choice([1700.0, 1900.0, 2000.0], (6, 8)), np.nan)
    regions = np.array([[0, 0, 6, 8], [1, 2, 3, 4], [0, 0, 0, 0], [5, 7, 1, 1], [2, 2, 2, 2]])
    out = np.zeros((5, 3))
    look(mean, empty, regions, 150.0, out)
    for (r, c, rows, columns), found in zip(regions, out, strict=True):
        part, bare = mean[r : r + rows, c : c + columns].ravel(), empty[r : r + rows, c : c + columns].ravel()
        above = [b - m for m, b in zip(part, bare, strict=True) if np.isfinite(m) and np.isfinite(b)]
        measured = int(np.isfinite(part).sum())
        enough = above and 2 * len(above) >= measured
        expected = [
            sum(a > 150.0 for a in above) / len(above) if enough else np.nan,
            sum(above) / len(above) if enough else np.nan,
            measured / (rows * columns) if rows * columns else 0.0,
        ]
        np.testing.assert_allclose(found, expected)


def test_a_block_that_is_not_measured_any_more_keeps_its_depth_in_the_rooms_reference() -> None:
    seconds = 3 * RECENT + 20
    depth = np.full((4 * seconds, 6, 8), 2500.0) + np.random.default_rng(8).normal(0.0, 1.0, (4 * seconds, 6, 8))
    depth[4 * (RECENT + 4) :, 2, 3] = np.nan
    operator = View()
    meta = {"simplified": {"block": 8, "components": 1}}
    operator.open({"in": StreamSpec((6, 8), rate_hz=4.0, units=("mm",), meta=meta)})
    time, cut = grid(4.0, 4 * seconds), 4 * (2 * RECENT + 6)
    operator.process("in", Chunk(time[:cut], depth[:cut], int(time[cut - 1])))
    then = operator.state.reference.copy()
    operator.process("in", Chunk(time[cut:], depth[cut:], int(time[-1])))
    assert np.isfinite(then[2, 3]) and operator.state.reference[2, 3] == then[2, 3]
    assert (np.delete(operator.state.reference.ravel(), 19) != np.delete(then.ravel(), 19)).all()
