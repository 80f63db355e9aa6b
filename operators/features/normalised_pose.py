"""Normalised poses of any animal or marker set: seen from one marker, turned so that another lies ahead (thesis, 5.3.2)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.features.pose import FLAT, middle, point_names
from kinegraph.operators.inputs.directions import HELP, right_handed_up
from kinegraph.operators.inputs.marker_columns import marker_columns
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.domain.axes import WAYS, Axes, Up, in_axes
from kinegraph.stream.domain.joint_names import find_point
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def normalise_pose(
    x: Samples, columns: Times, parts: Times, vertical: int, sign: float, heading: Samples, work: Samples, out: Samples
) -> None:
    """Poses of the bodies `x` (n, width) into `out` (n, 3 m).

    columns  (p, 3)  columns of the input's markers that are used
    parts    (j, 2)  the input's markers for each marker of the set: the origin, the one ahead, the m emitted; empty: missing
    heading  (2,)    cosine and sine of the newest heading; NaN before there is one
    work     (3, 3)  room for the origin, the marker ahead, and one more
    """
    m = out.shape[1] // 3
    for i in range(x.shape[0]):
        for j in range(2):
            middle(x[i], columns, parts[j, 0], parts[j, 1], vertical, sign, work[j])
        along, across = work[1, 0] - work[0, 0], work[1, 1] - work[0, 1]
        flat = math.sqrt(along * along + across * across)
        whole = math.sqrt(flat * flat + (work[1, 2] - work[0, 2]) ** 2)
        known = whole < math.inf
        if known and flat > FLAT * whole:
            heading[0], heading[1] = along / flat, across / flat
        for k in range(m):
            out[i, 3 * k : 3 * k + 3] = math.nan
            if not known or parts[2 + k, 0] == parts[2 + k, 1]:
                continue
            middle(x[i], columns, parts[2 + k, 0], parts[2 + k, 1], vertical, sign, work[2])
            a, b, c = work[2, 0] - work[0, 0], work[2, 1] - work[0, 1], work[2, 2] - work[0, 2]
            ahead = a * heading[0] + b * heading[1]
            side = a * heading[1] - b * heading[0]
            if abs(ahead) < math.inf and abs(side) < math.inf and abs(c) < math.inf:
                out[i, 3 * k], out[i, 3 * k + 1], out[i, 3 * k + 2] = ahead, c, side


@dataclass(slots=True)
class NormalisedPoseState:
    columns: Times
    parts: Times
    vertical: int
    sign: float
    heading: Samples
    work: Samples


@dataclass(frozen=True, slots=True)
class NormalisedPose(SampleWise[NormalisedPoseState]):
    """Markers (points, 3) in; out comes the pose in a set of markers of its own, wherever the body stands and whichever way it faces.

    origin   the marker that positions are relative to, e.g. the withers
    ahead    the marker that lies in the x-y plane at positive x, e.g. the sacrum: all are rotated about the vertical y until it does
    markers  the set: marker: [marker of the input, ...], their mean. Recordings of different set-ups, each with a table of its own,
             get the same channels. Without it, the input's own markers

    Joints of a human body are found in any spelling (`hip_l`, left_hip, LHIP).

    A marker of the set that the input lacks is NaN throughout, and its channels are listed in `meta["missing"]`; `origin` and `ahead`
    must be there. A hidden marker is NaN; where `origin` or `ahead` is hidden, so is the whole pose. While these two stand nearly above
    one another the last heading holds. The unit is that of the input. No delay; any rate.

    Source: thesis, 5.3.2 (withers and sacrum of horses). `operators.features.pose.Pose` is the one for human joints, by the hips.

    >>> horse = np.array([[[1.0, 1.5, 2.0], [1.0, 1.5, 3.0], [1.2, 0.0, 2.0]]])
    >>> names = ["withers", "head", "hoof"]
    >>> NormalisedPose("withers", "head")(horse, rate_hz=100, channels=names, units=["m"]).round(2)
    array([[ 0. ,  0. ,  0. ,  1. ,  0. ,  0. ,  0. , -1.5, -0.2]])
    """

    origin: str = param(help="the marker that positions are relative to")
    ahead: str = param(help="the marker that is turned into the x-y plane, at positive x")
    markers: Mapping[str, tuple[str, ...]] | None = param(None, help="marker: [marker of the input, ...]; their mean")
    up: Up | None = param(None, help=f"{HELP} y")

    kernel = normalise_pose

    def begin(self, spec: StreamSpec) -> NormalisedPoseState:
        if len(set(spec.units)) != 1:
            raise InputError("in", spec.describe(), "markers in one unit")
        table = self._table(spec)
        absent = self._absent(spec, table)
        for parameter, marker in (("origin", self.origin), ("ahead", self.ahead)):
            if marker not in table:
                raise ParameterError(parameter, marker, f"a marker of the set; {nearest(marker, table)}")
            if marker in absent:
                raise ParameterError(parameter, marker, f"a marker that is there; the input has no {absent[marker]}")
        if self.origin == self.ahead:
            raise ParameterError("ahead", self.ahead, "another marker than the origin")
        columns: list[tuple[int, int, int]] = []
        parts = []
        for marker in (self.origin, self.ahead, *table):
            first = len(columns)
            if marker not in absent:
                columns += [marker_columns(spec, name, "markers") for name in table[marker]]
            parts.append((first, len(columns)))
        up = right_handed_up(spec, self.up, "y", WAYS)
        return NormalisedPoseState(
            columns=np.array(columns, np.int64),
            parts=np.array(parts, np.int64),
            vertical="xyz".index(up[-1]),
            sign=-1.0 if up[0] == "-" else 1.0,
            heading=np.full(2, np.nan),
            work=np.zeros((3, 3)),
        )

    def gives(self, spec: StreamSpec) -> StreamSpec:
        table = self._table(spec)
        absent = self._absent(spec, table)
        return spec.derive(
            shape=(3 * len(table),),
            channels=tuple(f"{marker}.{axis}" for marker in table for axis in "xyz"),
            channel_axis=0,
            meta={**in_axes(spec, Axes("y")), "missing": [f"{marker}.{axis}" for marker in absent for axis in "xyz"]},
        )

    def _table(self, spec: StreamSpec) -> dict[str, tuple[str, ...]]:
        """Every marker of the set, with those of the input that make it up."""
        if self.markers is None:
            return {name: (name,) for name in point_names(spec)}
        if empty := [marker for marker, names in self.markers.items() if not names]:
            raise ParameterError("markers", empty[0], "at least one marker of the input for it")
        return dict(self.markers)

    def _absent(self, spec: StreamSpec, table: Mapping[str, tuple[str, ...]]) -> dict[str, str]:
        """The markers of the set that cannot be made, each with a marker that the input lacks."""
        there = point_names(spec)
        lacking = {
            marker: [name for name in names if find_point(name, there) is None] for marker, names in table.items()
        }
        return {marker: names[0] for marker, names in lacking.items() if names}

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(53)
        names = ("withers", "S1", "S2", "head", "hoof")
        body = 3.0 * rng.normal(size=(5, 3)) + 0.05 * rng.normal(size=(150, 5, 3)).cumsum(axis=0)
        spec = StreamSpec((5, 3), rate_hz=100.0, channels=names, units=("mm",))
        table = {"withers": ("withers",), "sacrum": ("S1", "S2"), "tail": ("T9",), "hoof": ("hoof",)}
        inputs = {"in": (spec, grid(100.0, 150), body)}
        return [
            Case(cls("withers", "head"), inputs, least=150),
            Case(cls("withers", "sacrum", table, "-z"), inputs, least=150),
        ]
