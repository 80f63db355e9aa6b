"""A map of recorded motion as it is stored: normalised poses of many sequences, their place on a PCA, and a self-organising map of them.

Made by `kinegraph motion train map`, asked by operators.maps.pose_map.retrieve.Retrieve, shown by `kinegraph motion map`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.data.model_file import Model, ModelError, read_model, write_model

KIND = "map"
MISSING = -32768
"""A coordinate that is not known."""
LARGEST = 32767
MAX_MARKERS = 64
"""Markers are chosen by the bits of one number."""


@dataclass(frozen=True, slots=True)
class PoseSequence:
    """Poses that follow one another: frames `first` to `last - 1` of the index.

    name      of the recording, and its stream and part where there are several
    start_s   when it begins, in seconds from the recording's first pose
    rate_hz   of the recording itself, before it was brought to the index's
    facts     of its session: health, gait, subject, ...
    missing   markers of the set that its recording lacks
    """

    name: str
    first: int
    last: int
    start_s: float = 0.0
    rate_hz: float = 0.0
    facts: dict[str, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MotionIndex:
    """
    markers, bones, unit, rate_hz   of all poses; bones (b, 2) join markers by number; x ahead of the origin, y up
    sequences   in the order of their frames
    used        (u,) numbers of the markers that the map is made of
    poses       (n, 3 m) int16 in steps of `step` units; MISSING where not known
    pca         (n, 2) float32: places; 0, 0 (and cell -1) where a used marker is missing
    mean, axes  (3 u,), (2, 3 u); explained (2,): shares of the variance
    codes       (rows * columns, 3 u): the pose of each cell, row by row; columns: how many there are
    cell        (n,) int16: the nearest cell of each pose, -1: it has no place; som (n, 2) float32: column and row, between cells
    rank        (n,) uint16: which share of poses, in 65535ths, has an error of at most this one's
    errors      (1024,) quantiles of the quantisation error, from 0 to 1
    quantisation, topographic   the mean error (unit), and the share of poses with two nearest cells that do not touch
    """

    markers: tuple[str, ...]
    bones: Times
    unit: str
    rate_hz: float
    sequences: tuple[PoseSequence, ...]
    used: Times
    step: float
    poses: Array
    pca: Array
    mean: Samples
    axes: Samples
    explained: Samples
    columns: int
    codes: Samples
    cell: Array
    som: Array
    rank: Array
    errors: Samples
    quantisation: float
    topographic: float

    @property
    def channels(self) -> list[str]:
        """Names of the numbers that the map is made of, as operators.features.normalised_pose names them."""
        return [f"{self.markers[m]}.{axis}" for m in self.used for axis in "xyz"]

    def frames(self, numbers: Array | slice) -> Array:
        """Poses (k, m, 3) float32 in `unit`; NaN where not known."""
        found = self.poses[numbers]
        made = np.where(found == MISSING, np.float32(np.nan), found * np.float32(self.step))
        return made.reshape(len(found), len(self.markers), 3)

    def of(self, frame: int) -> int:
        """The number of the sequence that a frame lies in."""
        return int(np.searchsorted([s.last for s in self.sequences], frame, side="right"))

    def write(self, path: Path, header: dict[str, Any]) -> None:
        """Write it as a model, not compressed, so that a million poses are read in a moment. Raises OSError."""
        facts = {name: getattr(self, name) for name in NUMBERS}
        facts |= {"markers": list(self.markers), "unit": self.unit, "channels": self.channels}
        facts["sequences"] = [{f.name: getattr(s, f.name) for f in fields(PoseSequence)} for s in self.sequences]
        write_model(path, KIND, {**header, **facts}, {name: getattr(self, name) for name in ARRAYS}, compressed=False)

    @staticmethod
    def read(path: Path) -> MotionIndex:
        """Read one, and refuse what does not hang together. Raises ModelError."""
        model = read_model(path, KIND)
        try:
            facts = {name: float(model.header[name]) for name in NUMBERS}
            columns = int(facts.pop("columns"))
            markers = tuple(str(name) for name in model.header["markers"])
            unit = str(model.header["unit"])
            sequences = tuple(_sequence(one) for one in model.header["sequences"])
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise ModelError(f"{path}: the header does not describe a map of motion ({error})") from None
        sizes = _sizes(model, len(markers))
        arrays = {name: model.array(name, sizes[name], dtype) for name, dtype in ARRAYS.items()}
        made = MotionIndex(markers=markers, unit=unit, sequences=sequences, columns=columns, **facts, **arrays)  # type: ignore[arg-type]
        if wrong := _wrong(made):
            raise ModelError(f"{path}: {wrong}; train it again")
        return made


NUMBERS = ("rate_hz", "step", "columns", "quantisation", "topographic")
ARRAYS: dict[str, Any] = {
    "bones": np.int64, "used": np.int64, "poses": np.int16, "pca": np.float32, "mean": np.float64, "axes": np.float64,
    "explained": np.float64, "codes": np.float64, "cell": np.int16, "som": np.float32, "rank": np.uint16, "errors": np.float64,
}  # fmt: skip


def _sequence(record: dict[str, Any]) -> PoseSequence:
    facts = {str(k): str(v) for k, v in record["facts"].items()}
    first, last = int(record["first"]), int(record["last"])
    start_s, rate_hz = float(record["start_s"]), float(record["rate_hz"])
    return PoseSequence(str(record["name"]), first, last, start_s, rate_hz, facts, tuple(map(str, record["missing"])))


def _sizes(model: Model, markers: int) -> dict[str, Sequence[int | None]]:
    n = len(model.array("poses", (None, 3 * markers), np.int16))
    w = 3 * len(model.array("used", (None,), np.int64))
    return {
        "bones": (None, 2), "used": (None,), "poses": (n, 3 * markers), "pca": (n, 2), "mean": (w,), "axes": (2, w),
        "explained": (2,), "codes": (None, w), "cell": (n,), "som": (n, 2), "rank": (n,), "errors": (1024,),
    }  # fmt: skip


def _wrong(index: MotionIndex) -> str:
    """What does not hang together in an index; "": nothing."""
    n, m = len(index.poses), len(index.markers)
    ends = [0, *(s.last for s in index.sequences)]
    if not (n and 0 < m <= MAX_MARKERS and len(set(index.markers)) == m):
        return f"a map has poses of 1 to {MAX_MARKERS} markers, each with a name of its own"
    if any(s.first != end or s.first >= s.last for s, end in zip(index.sequences, ends, strict=False)) or ends[-1] != n:
        return "its sequences do not follow one another"
    if not (0.0 < index.rate_hz <= 10_000.0 and 0.0 < index.step < 1e30):
        return "a map has a rate and a step"
    if any(len(a) and (a.min() < 0 or a.max() >= m) for a in (index.bones, index.used)) or not len(index.used):
        return "it names a marker that is not there"
    cells = len(index.codes)
    if not (0 < index.columns <= cells <= 10_000) or cells % index.columns or index.cell.max() >= cells:
        return "its grid has holes"
    if np.any(np.diff(index.errors) < 0.0):
        return "its errors are not in order"
    return ""
