"""Mean depth of a region of every frame: the simplest thing that a depth camera can tell (whether somebody lies there, and how high)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

Frames = NDArray[np.uint16]


@kernel
def region_means(frames: Frames, row: int, column: int, rows: int, columns: int, least: float, out: Samples) -> None:
    """The mean of the non-zero pixels in a rectangle of `frames` (n, height, width), and their share, into `out` (n, 2).

    The mean is NaN where less than the share `least` is valid. Pixels are summed as whole numbers, so that nothing is rounded.
    """
    for i in range(frames.shape[0]):
        total, valid = 0, 0
        for y in range(row, row + rows):
            for x in range(column, column + columns):
                depth = frames[i, y, x]
                total += depth
                valid += depth != 0
        share = valid / (rows * columns)
        out[i, 0] = total / valid if valid > 0 and share >= least else math.nan
        out[i, 1] = share


@dataclass(slots=True)
class RegionState:
    """Every frame is for itself; only the region is held.

    region   (4,)  row, column, rows, columns
    """

    region: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class RegionDepth(Operator[RegionState]):
    """Frames (height, width) uint16 in mm in, 0: no measurement; out (2,): the mean depth in a rectangle, the share of valid pixels.

    No delay, no state; gaps are passed on as they are. The mean is NaN where fewer than `min_valid` of the region's pixels are valid.

    >>> frame = np.array([[[1000, 1200], [0, 1100]]], np.uint16)
    >>> RegionDepth()(frame, rate_hz=30, units=["mm"]).tolist()
    [[1100.0, 0.75]]
    """

    row: int = param(0, least=0, help="the region's first row of pixels, from the top")
    column: int = param(0, least=0, help="its first column, from the left")
    rows: int = param(0, least=0, help="how many rows it has; 0: all the rest")
    columns: int = param(0, least=0, help="how many columns it has; 0: all the rest")
    min_valid: float = param(0.2, least=0.0, most=1.0, help="share of valid pixels below which there is no mean")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if len(spec.shape) != 2 or spec.dtype != np.dtype(np.uint16):
            raise InputError("in", spec.describe(), "depth frames: (height, width) uint16")
        height, width = spec.shape
        rows = _within("row", self.row, "rows", self.rows, height)
        columns = _within("column", self.column, "columns", self.columns, width)
        self.set_state(RegionState(np.array([self.row, self.column, rows, columns])))
        channels, units = ("depth", "valid"), (spec.units[0], "")
        return {"out": spec.derive(shape=(2,), dtype=np.dtype(np.float64), channels=channels, units=units)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        out = np.empty((len(chunk.time), 2))
        row, column, rows, columns = self.state.region
        region_means(chunk.data, row, column, rows, columns, self.min_valid, out)
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(11)
        frames = random.integers(1, 4000, (90, 12, 16)).astype(np.uint16)
        frames[random.random(frames.shape) < 0.1] = 0
        frames[40:43] = 0
        spec = StreamSpec((12, 16), np.dtype(np.uint16), 30.0, units=("mm",))
        inputs = {"in": (spec, grid(30.0, 90), frames)}
        return [Case(cls(), inputs, least=90), Case(cls(row=2, column=3, rows=5, columns=4), inputs, least=90)]


def _within(start_name: str, start: int, count_name: str, count: int, size: int) -> int:
    """How many rows (or columns) of `size` the region has."""
    if start >= size:
        raise ParameterError(start_name, start, f"below {size}, the size of the frames")
    if start + count > size:
        raise ParameterError(
            count_name, count, f"at most {size - start}, for frames of {size} and {start_name} {start}"
        )
    return count or size - start
