"""Mean depth of a region, against numpy; what its parameters may be."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.frames.region import RegionDepth
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid

SPEC = StreamSpec((20, 30), np.dtype(np.uint16), 30.0, units=("mm",))


def test_it_is_the_mean_of_the_valid_pixels() -> None:
    random = np.random.default_rng(3)
    frames = random.integers(0, 65536, (50, 20, 30)).astype(np.uint16)
    frames[random.random(frames.shape) < 0.3] = 0
    frames[7] = 0
    frames[8, 5:11, 7:18].flat[2:] = 0
    operator = RegionDepth(row=5, column=7, rows=6, columns=11)
    out = operator.open({"in": SPEC})["out"]
    assert out.channels == ("depth", "valid") and out.units == ("mm", "") and out.rate_hz == 30.0
    made = operator.process("in", Chunk(grid(30.0, 50), frames, 10**12, 4))
    region = frames[:, 5:11, 7:18].reshape(50, -1).astype(np.float64)
    share = (region > 0).mean(axis=1)
    with np.errstate(invalid="ignore"):
        expected = np.where(share >= 0.2, region.sum(axis=1) / (region > 0).sum(axis=1), np.nan)
    assert np.array_equal(made.data, np.stack([expected, share], axis=1), equal_nan=True)
    assert np.isnan(made.data[7:9, 0]).all() and np.isfinite(made.data[9:, 0]).all()
    assert made.lost == 4 and made.until == 10**12


def test_the_whole_frame_unless_told_otherwise() -> None:
    operator = RegionDepth(row=18)
    operator.open({"in": SPEC})
    assert operator.state.region.tolist() == [18, 0, 2, 30]


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"row": 20}, "row is 20; it must be below 20"),
        ({"column": 25, "columns": 6}, "columns is 6; it must be at most 5"),
    ],
)
def test_a_region_lies_in_the_frame(parameters: dict[str, int], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        RegionDepth(**parameters).open({"in": SPEC})


def test_signals_are_no_frames() -> None:
    with pytest.raises(InputError, match="depth frames"):
        RegionDepth().open({"in": StreamSpec((3,))})
