"""Gain and offset, with the change of unit that they mean: counts to microvolts, g to m/s2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import width_of
from kinegraph.stream.domain.axes import Axes, in_axes
from kinegraph.stream.domain.rotation import rotation_free, rotations
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


@kernel
def straight_line(x: Samples, line: Samples, out: Samples) -> None:
    """`x` (n, c) times `line[0]` (c,) plus `line[1]` (c,) into `out` (n, c); what is not finite becomes NaN."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = finite(x[i, c]) * line[0, c] + line[1, c]


@dataclass(slots=True)
class ScaleState:
    line: Samples
    """(2, width): gain and offset of every number of a sample."""


@dataclass(frozen=True, slots=True)
class Scale(SampleWise[ScaleState]):
    """Every number times `gain` plus `offset`, as float64. No delay; works at any rate, and passes gaps on as they are.

    `gain` and `offset` are one number for all, or one per channel of a signal, or of points (points, 3) one for each of x, y and z;
    `unit` names what comes out, if it changes. A negative gain turns an axis over: the axes that come out are declared so. The numbers of
    a rotation may be scaled alike and turned over; anything else would give no rotation, and is refused.

    >>> Scale(gain=0.5, offset=1.0)(np.array([0.0, 2.0, 4.0]), rate_hz=100)
    array([1., 2., 3.])
    """

    gain: float | tuple[float, ...] = param(
        1.0, help="one number, or one per channel; of points one for x, y and z each"
    )
    offset: float | tuple[float, ...] = param(0.0, help="added after the gain; one number, or as many as gains")
    unit: str | None = param(None, help="the unit of what comes out; left out: unchanged")

    kernel = straight_line

    def begin(self, spec: StreamSpec) -> ScaleState:
        line = np.empty((2, width_of(spec)))
        for row, parameter in enumerate(("gain", "offset")):
            given = getattr(self, parameter)
            if isinstance(given, Sequence):
                given = self._each(parameter, given, spec)
            line[row] = given
        if not np.isfinite(line).all():
            parameter = "gain" if not np.isfinite(line[0]).all() else "offset"
            raise ParameterError(parameter, getattr(self, parameter), "finite")
        for start in rotations(spec):
            gain, offset = line.reshape(2, -1, spec.shape[-1])[:, :, start : start + 4]
            if offset.any() or np.ptp(np.abs(gain), axis=-1).any():
                rotation_free(spec)
        return ScaleState(line)

    @staticmethod
    def _each(parameter: str, given: Sequence[float], spec: StreamSpec) -> Samples:
        """One number for each of a sample's, from one per channel, or of points one per axis. Raises InputError and ParameterError."""
        points = _is_points(spec)
        if not spec.is_signal and not points:
            raise InputError(
                "in", spec.describe(), f"a signal or points, as {parameter} has one number per channel or axis"
            )
        if len(given) != spec.shape[-1]:
            which = "one each for x, y and z" if points else "one per channel"
            raise ParameterError(parameter, given, f"one number, or {spec.shape[-1]}: {which}")
        return np.tile(np.asarray(given, np.float64), spec.shape[0] if points else 1)

    def gives(self, spec: StreamSpec) -> StreamSpec:
        if _is_points(spec) and (axes := Axes.of(spec)):
            signs = self.gain if isinstance(self.gain, Sequence) else (self.gain,) * 3
            spec = spec.derive(meta=in_axes(spec, axes.flipped(tuple(signs))))
        return spec if self.unit is None else spec.derive(units=(self.unit,))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(3).integers(-2000, 2000, (400, 2)).astype(np.int16)
        spec = StreamSpec((2,), np.dtype(np.int16), 500.0, channels=("left", "right"), units=("counts",))
        case = {"in": (spec, grid(500.0, 400), data)}
        points = StreamSpec((2, 3), rate_hz=30.0, channels=("hip", "knee"), units=("m",))
        marks = np.random.default_rng(4).normal(size=(60, 2, 3))
        return [
            Case(cls(gain=0.5, offset=-1.0, unit="uV"), case, least=400),
            Case(cls(gain=(0.5, 2.0)), case, least=400),
            Case(
                cls(gain=(1.0, -1.0, -1.0), offset=(0.0, 1.0, 0.0)), {"in": (points, grid(30.0, 60), marks)}, least=60
            ),
        ]


def _is_points(spec: StreamSpec) -> bool:
    return not spec.is_event and len(spec.shape) == 2 and spec.shape[1] == 3
