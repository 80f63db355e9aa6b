"""Turns points into other axes, and declares axes for sources that cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.inputs.marker_columns import marker_names
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import width_of
from kinegraph.stream.domain.axes import CAMERA, WAYS, Axes, Up, in_axes
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def turn_points(x: Samples, columns: Times, signs: Samples, out: Samples) -> None:
    """Numbers `columns` (c,) of `x` (n, c), times `signs` (c,), into `out` (n, c); what is not finite becomes NaN."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = signs[c] * finite(x[i, columns[c]])


@dataclass(slots=True)
class TurnAxesState:
    columns: Times
    signs: Samples


@dataclass(frozen=True, slots=True)
class TurnAxes(SampleWise[TurnAxesState]):
    """Points (points, 3) in other axes: what is up stays up, and what is forward stays forward. No delay; any rate.

    The input's axes are those that it declares. An input without axes, such as a table of markers or an LSL stream, is in the axes that
    `from_up` and `from_forward` say. Where one of both forward axes is not known, x stays x if it can. The output declares its axes.
    A signal with x, y and z of each marker, in this order, is taken as well.

    >>> TurnAxes(from_up="z")(np.array([[[1.0, 2.0, 3.0]]]), rate_hz=100)
    array([[[ 1.,  3., -2.]]])
    """

    exemptions: ClassVar[dict[str, str]] = {"channels": "coordinates of a point change places"}

    up: Up = param("y", help="the axis that points up in what comes out")
    forward: Literal["", "x", "y", "z", "-x", "-y", "-z"] = param(
        "z", help="the axis along which bodies face in what comes out; empty: not declared"
    )
    from_up: Up | None = param(None, help="the axis that points up in an input that does not declare it")
    from_forward: Literal["", "x", "y", "z", "-x", "-y", "-z"] = param(
        "", help="with from_up: the axis along which bodies face, if it is known"
    )

    kernel = turn_points

    def begin(self, spec: StreamSpec) -> TurnAxesState:
        if spec.is_event or not _is_points(spec) or "skeleton" in spec.meta or "rotation" in spec.meta:
            raise InputError(
                "in", spec.describe(), "points (points, 3), or a signal with x, y and z of each, one after the other"
            )
        columns, signs = self._own(spec).to(self._wanted)
        n = width_of(spec) // 3
        first = 3 * np.repeat(np.arange(n), 3)
        return TurnAxesState(first + np.tile(np.array(columns, np.int64), n), np.tile(np.array(signs), n))

    def gives(self, spec: StreamSpec) -> StreamSpec:
        wanted = self._wanted
        known = wanted if self._own(spec).forward else Axes(wanted.up)
        return spec.derive(meta=in_axes(spec, known))

    @property
    def _wanted(self) -> Axes:
        return _axes("forward", self.up, self.forward)

    def _own(self, spec: StreamSpec) -> Axes:
        """The input's axes. Raises ParameterError if they are unknown, or given twice."""
        declared = Axes.of(spec)
        if declared and self.from_up not in (None, declared.up):
            raise ParameterError("from_up", self.from_up, f"left out: the input declares {declared.describe()}")
        if declared:
            return declared
        if self.from_up is None:
            raise ParameterError("from_up", None, f"one of {', '.join(WAYS)}: the input does not declare its axes")
        return _axes("from_forward", self.from_up, self.from_forward)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        points = np.random.default_rng(7).normal(size=(60, 3, 3))
        points[20:25, 1] = np.nan
        spec = StreamSpec((3, 3), rate_hz=30.0, channels=("a", "b", "c"), units=("m",), meta={"axes": CAMERA.facts()})
        names = tuple(f"{name}.{axis}" for name in "abc" for axis in "xyz")
        flat = StreamSpec((9,), rate_hz=30.0, channels=names, units=("mm",))
        return [
            Case(cls(), {"in": (spec, grid(30.0, 60), points)}, least=60),
            Case(cls("z", "", "y"), {"in": (flat, grid(30.0, 60), points.reshape(60, -1))}, least=60),
        ]


def _axes(parameter: str, up: str, forward: str) -> Axes:
    try:
        return Axes(up, forward)
    except ValueError:
        raise ParameterError(parameter, forward, f"along another axis than {up}, which points up") from None


def _is_points(spec: StreamSpec) -> bool:
    """Whether x, y and z of every point are one after the other."""
    if len(spec.shape) == 2:
        return spec.shape[1] == 3
    names = marker_names(spec)
    ends = [channel[-1:].lower() for channel in spec.channels]
    return spec.is_signal and 3 * len(names) == spec.shape[0] == len(ends) and ends == [*"xyz"] * len(names)
