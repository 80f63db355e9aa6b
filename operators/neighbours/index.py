"""The index as a Python object: insert frames, ask for their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinegraph.operators.neighbours.follow import ask_nearest, ask_within, enter, follow, slot_in, tell_within
from kinegraph.operators.neighbours.layout import LANES, Floats, IndexState, allocate, clear
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.data.state import pack, unpack
from kinegraph.stream.errors import KinegraphError

Nearest: TypeAlias = tuple[Times, Floats]
"""Numbers of frames (m,) int64, and their distances (m,) float32."""

NEWEST = np.empty(0)
"""Given as the frame that is asked about: the newest."""

LIMITS = {"width": (1, 4096), "window": (1, 10_000_000), "most": (0, 65_536)}


class NeighbourError(KinegraphError):
    """Something that an index cannot do: a frame of another width, a frame that has left."""


class Index:
    """The newest `window` frames of `width` features, and their exact nearest neighbours (Euclidean, float32).

        index = Index(width=24, window=10_000, most=32)
        for x in frames:                                   # (24,)
            index.insert(x)                                # the oldest leaves by itself
            frames, distances = index.nearest(32, band=30)

    Frames are numbered from 0 as they are inserted. A frame is rounded to float32 when it comes in; one with a value that is not finite, or
    beyond 1e18, takes its number and its turn but neither is nor has a neighbour. The distance is the root of the sum over w (x - q)^2,
    summed in float32 in the order of the features (`distance.py` states the rule to the bit). Nearest first; of two equally near frames
    the older one comes first, and is the one that is kept. Within a radius are those with a reported distance of at most the radius
    rounded to float32. So the answer is one, on every path, and that of a plain loop over all frames.

    `vector=False` takes plain loops instead of vector code: slower, the same bits. Memory does not change after the first line; no call
    allocates but for what it returns, and no call rebuilds anything. An index belongs to one thread. Raises NeighbourError.
    """

    def __init__(self, width: int, window: int, most: int = 32, *, vector: bool = True) -> None:
        for name, value in {"width": width, "window": window, "most": most}.items():
            least, largest = LIMITS[name]
            if not least <= value <= largest:
                raise NeighbourError(f"{name} is {value}; it must be from {least} to {largest}")
        self.state: IndexState = allocate(width, window, most, vector=vector)

    @classmethod
    def of(cls, state: IndexState) -> Index:
        """The index that an operator keeps in its own state."""
        made = cls.__new__(cls)
        made.state = state
        return made

    def __len__(self) -> int:
        """How many frames the window holds, bad ones included."""
        return int(self.state.head["next"]) - self.first

    @property
    def width(self) -> int:
        return int(self.state.head["width"])

    @property
    def window(self) -> int:
        return int(self.state.head["window"])

    @property
    def first(self) -> int:
        """The number of the oldest frame in the window."""
        return int(max(self.state.head["since"], self.state.head["next"] - self.state.head["window"]))

    @property
    def newest(self) -> int:
        """The number of the newest frame; -1 before the first."""
        return int(self.state.head["next"]) - 1

    @property
    def memory_bytes(self) -> int:
        return self.state.floats.nbytes + self.state.books.nbytes

    def insert(self, x: ArrayLike, *, radius: float = np.nan) -> int:
        """Insert a frame (width,); returns its number. `radius` is its own, for `within(..., both=True)` of later frames."""
        enter(self.state.floats, self.state.books, self._row(x), float(radius))
        return self.newest

    def follow(
        self, x: ArrayLike, k: int, *, band: int = 0, radius: float = np.nan
    ) -> tuple[NDArray[np.int64], Floats]:
        """Insert many frames (n, width), and find the k nearest of each at its time, in one call.

        Returns frames (n, k) and distances (n, k); -1 and NaN where there are fewer than k.
        """
        rows = np.ascontiguousarray(x, np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.width:
            raise NeighbourError(f"x has shape {rows.shape}; it must be (n, {self.width})")
        frames = np.empty((len(rows), self._few(k)), np.int64)
        distances = np.empty(frames.shape, np.float32)
        follow(self.state.floats, self.state.books, rows, band, float(radius), frames, distances)
        return frames, distances

    def nearest(self, k: int, x: ArrayLike | None = None, *, at: int | None = None, band: int = 0) -> Nearest:
        """The k nearest of `x` (width,), or of the newest frame; fewer if there are fewer.

        Frames numbered at most `band` from `at` (left out: the newest frame's number) are passed over: 0 leaves out the
        frame itself, -1 nothing.
        """
        s, k = self.state, self._few(k)
        frames, distances = np.empty(k, np.int64), np.empty(k, np.float32)
        at = self.newest if at is None else at
        count = ask_nearest(s.floats, s.books, NEWEST if x is None else self._row(x), at, band, frames, distances)
        return frames[:count], distances[:count]

    def within(
        self, radius: float, x: ArrayLike | None = None, *, at: int | None = None, band: int = 0, both: bool = False
    ) -> Nearest:
        """All within `radius` of `x`, or of the newest frame, oldest first; `at` and `band` as in `nearest`.

        With `both`, also the frames that have it in their own radius (see `insert`); `within_ways` tells which is the case.
        """
        frames, distances, _ = self.within_ways(radius, x, at=at, band=band, both=both)
        return frames, distances

    def within_ways(
        self, radius: float, x: ArrayLike | None = None, *, at: int | None = None, band: int = 0, both: bool = True
    ) -> tuple[Times, Floats, Array]:
        """As `within`, and (m, 2) bool: whether the frame is within `radius`, and whether `x` is within the frame's own radius."""
        s, at = self.state, self.newest if at is None else at
        marked = ask_within(s.floats, s.books, NEWEST if x is None else self._row(x), at, band, float(radius), both)
        frames, distances = np.empty(marked, np.int64), np.empty(marked, np.float32)
        ways = np.empty((marked, 2), np.bool_)
        tell_within(s.floats, s.books, float(radius), frames, distances, ways)
        return frames, distances, ways

    def frame(self, number: int) -> Floats:
        """A frame of the window (width,), as it was rounded; NaN in all features if it was bad."""
        s = self.state
        if not self.first <= number <= self.newest:
            raise NeighbourError(f"frame {number} is not in the window, which holds {self.first} to {self.newest}")
        slot = slot_in(s.floats, s.books, number)
        rows = 1 + self.width
        tiles = s.floats_at("tiles_at", int(s.head["slots"]) * rows).reshape(-1, rows, LANES)
        lanes = tiles[slot // LANES, :, slot % LANES]
        return lanes[1:].copy() if lanes[0] == 0.0 else np.full(self.width, np.nan, np.float32)

    def weigh(self, weights: ArrayLike) -> None:
        """Weights (width,) of the features from now on, finite and not negative; they take effect on all frames at once."""
        set_weights(self.state, self._row(weights))

    def clear(self) -> None:
        """Forget all frames; numbers and weights go on."""
        clear(self.state)

    def snapshot(self) -> dict[str, Array]:
        """Everything, as plain arrays (copies)."""
        return pack(self.state)

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from a snapshot of an index of the same width, window and most."""
        unpack(self.state, arrays)

    def _row(self, x: ArrayLike) -> Samples:
        row: Samples = np.ascontiguousarray(x, np.float64)
        if row.shape != (self.width,):
            raise NeighbourError(f"shape is {row.shape}; it must be ({self.width},)")
        return row

    def _few(self, k: int) -> int:
        most = int(self.state.head["most"])
        if not 0 <= k <= most:
            raise NeighbourError(f"k is {k}; it must be from 0 to {most} (the index was made for `most` of them)")
        return k


def set_weights(state: IndexState, weights: Samples | Sequence[float]) -> None:
    """Set the weights of the features; raises NeighbourError where one is negative or not finite."""
    with np.errstate(over="ignore"):
        row = np.asarray(weights, np.float64).astype(np.float32)
    if not (np.isfinite(row).all() and (row >= 0).all()):
        raise NeighbourError(
            f"weights are {list(weights)}; they must be finite in float32 (up to 3.4e38) and not negative"
        )
    state.floats_at("weights_at", len(row))[:] = row
    state.head["weighted"] = bool((row != 1.0).any())
