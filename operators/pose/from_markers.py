"""Whole poses of a recording of many markers: what `kinegraph motion train pose` learns from where no skeleton was recorded (C3D)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from kinegraph.operators.pose.landmarks import NAMES, find_landmarks
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec, Times
from kinegraph.stream.errors import InputError

LEG = ("head", "ankle_l", "ankle_r")


def solved(
    spec: StreamSpec,
    time: Times,
    rows: Samples,
    chosen: Times,
    given: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
) -> Samples | str | None:
    """Poses (k, 91) of markers `rows` (n, points, 3), by geometry, in the samples in which every landmark is seen; of the usual body.

    `given` maps landmarks to points, where names do not. Returns a reason for markers of which nothing can be
    learned: of no unit, of no body, or that show no more of one than the landmarks `chosen`. None for other streams.
    """
    if spec.is_event or len(spec.shape) != 2 or spec.shape[1] != 3 or not spec.channels or "mesh" in spec.meta:
        return None
    given = {landmark: points for landmark, points in given.items() if set(points) <= set(spec.channels)}
    try:
        found, columns = find_landmarks(spec, given)
    except InputError:
        return "fewer than five of its points are known by their names"
    if not any(spec.units):
        return "its positions have no unit"
    wanted = [NAMES[k] for k in chosen]
    if missing := [name for name in dict.fromkeys((*wanted, *LEG)) if name not in found]:
        return f"it shows no {', '.join(missing)}"
    if set(found) <= {*wanted, "root"}:  # which is the middle of the hips, where nothing shows it
        return f"it shows no more than the model will be given ({', '.join(found)})"
    flat = np.ascontiguousarray(rows, np.float64).reshape(len(rows), -1)
    whole = np.isfinite(flat[:, columns[:, :3].ravel()]).all(axis=1)
    if not whole.any():
        return f"in no sample all of {', '.join(found)} are seen"
    operator = WholePose(up=_up(flat[whole], columns), feet=False, landmarks=given)
    try:
        operator.open({"in": spec})
    except InputError:
        return f"its positions are in {', '.join(dict.fromkeys(spec.units))}"
    made = operator.process("in", Chunk(time, flat, int(time[-1])))
    pose = next(chunk.data for port, chunk in made if port == "pose")
    return np.asarray(pose[whole])


def _up(flat: Samples, columns: Times) -> Literal["y", "z", "-y"]:
    """The axis along which the head is farthest above the ankles, of those that a stream of markers may have upwards."""

    def place(name: str) -> Samples:
        of = columns[columns[:, 3] == NAMES.index(name)]
        return np.asarray(flat[:, of[:, :3]].mean(axis=1))

    above = np.median(place(LEG[0]) - 0.5 * (place(LEG[1]) + place(LEG[2])), axis=0)
    heights: dict[Literal["y", "z", "-y"], float] = {"y": above[1], "z": above[2], "-y": -above[1]}
    return max(heights, key=lambda axis: heights[axis])
