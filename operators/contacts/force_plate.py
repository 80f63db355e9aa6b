"""A force plate's volts to forces, moments and the centre of pressure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.inputs.channels import find_channel
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz", "cop_x", "cop_y")
UNITS = ("N", "N", "N", "Nm", "Nm", "Nm", "m", "m")


@kernel
def plate(
    x: Samples, columns: Times, matrix: Samples, zero: Samples, origin: Samples, least: Samples, out: Samples
) -> None:
    """Rows of `out` (n, 8) are forces, moments and centre of pressure of the volts in `columns` (c,) of `x`.

    matrix (6, c), zero (c,) V, origin (3,) m: the true origin in the surface's frame, z below 0; least (1,) N.
    All are NaN where a channel is not finite; the centre of pressure also where the plate carries less than `least`.
    """
    wrench = np.zeros(6)
    for i in range(x.shape[0]):
        fine = True
        for r in range(6):
            total = 0.0
            for k in range(columns.shape[0]):
                total += matrix[r, k] * (x[i, columns[k]] - zero[k])
            wrench[r] = total
            fine = fine and abs(total) < math.inf
        fx, fy, fz = wrench[0], wrench[1], wrench[2]
        wrench[3] += origin[1] * fz - origin[2] * fy
        wrench[4] += origin[2] * fx - origin[0] * fz
        wrench[5] += origin[0] * fy - origin[1] * fx
        for r in range(wrench.shape[0]):
            out[i, r] = finite(wrench[r]) if fine else math.nan
        carries = fine and abs(fz) >= least[0] and abs(fz) > 0.0
        out[i, 6] = finite(-wrench[4] / fz) if carries else math.nan
        out[i, 7] = finite(wrench[3] / fz) if carries else math.nan


@dataclass(slots=True)
class ForcePlateState:
    columns: Times
    matrix: Samples
    zero: Samples
    origin: Samples
    least: Samples


@dataclass(frozen=True, slots=True)
class ForcePlate(SampleWise[ForcePlateState]):
    """Forces (N), moments (Nm) about the middle of the surface, and the centre of pressure (m) of one plate or belt. No delay.

    out   (8,) fx, fy, fz, mx, my, mz, cop_x, cop_y, in the plate's own axes (z down where the matrix has pushes positive)

    `matrix` is the plate's calibration: six rows (fx, fy, fz, mx, my, mz) with a number per channel, N or Nm per volt. A moment about the
    plate's true origin is moved to the surface by `origin_m`, as plates' sheets give it. The centre of pressure is that of the forces on
    the surface: (-my / fz, mx / fz). A treadmill with two belts is two of these nodes, each with its channels and its matrix.

    Source: the usual mechanics of a six-component plate; C3D's FORCE_PLATFORM types 2 and 4 have it so.

    >>> given, made = tried(ForcePlate)
    >>> given["in"][0].round(2), made[0].round(1)
    (array([ 0.96, -0.98, -0.8 , -0.2 ,  0.75,  0.85, -0.71]), array([-108.4,  -89.7,  -61.9,   17.1,   21.1,   -7.5,    0.3,   -0.3]))
    """

    channels: tuple[str, ...] = param(help="the plate's channels, in the order of the matrix's columns")
    matrix: tuple[tuple[float, ...], ...] = param(help="six rows, a number per channel: N or Nm per volt")
    zero_v: tuple[float, ...] = param((), help="what each channel says with nothing on the plate; left out: 0")
    origin_m: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), help="the true origin, from the middle of the surface: x, y, z in m"
    )
    min_force_N: float = param(20.0, least=0, help="below it there is no centre of pressure")

    kernel = plate

    def begin(self, spec: StreamSpec) -> ForcePlateState:
        if not spec.is_signal:
            raise InputError("in", spec.describe(), "a signal of channels")
        n = len(self.channels)
        if n < 1 or len(self.matrix) != 6 or any(len(row) != n for row in self.matrix):
            shape = f"{len(self.matrix)} rows of {sorted({len(row) for row in self.matrix})}"
            raise ParameterError("matrix", shape, f"six rows of {n} numbers, one per channel")
        if len(self.zero_v) not in (0, n):
            raise ParameterError("zero_v", list(self.zero_v), f"{n} numbers, one per channel, or left out")
        if len(self.origin_m) != 3:
            raise ParameterError("origin_m", list(self.origin_m), "x, y and z in m")
        columns = [find_channel(spec, name, "channels") for name in self.channels]
        return ForcePlateState(
            np.array(columns, np.int64),
            np.array(self.matrix, np.float64),
            np.array(self.zero_v or (0.0,) * n, np.float64),
            np.array(self.origin_m, np.float64),
            np.array([self.min_force_N]),
        )

    def gives(self, spec: StreamSpec) -> StreamSpec:
        return spec.derive(shape=(len(CHANNELS),), channels=CHANNELS, units=UNITS)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(4)
        names = tuple(f"v{i}" for i in range(6))
        spec = StreamSpec((7,), rate_hz=1000.0, channels=("emg", *names), units=("V",))
        matrix = tuple(
            tuple(float(v) for v in row) for row in np.diag([100.0, 100, 200, 30, 20, 10]) + rng.normal(0, 1, (6, 6))
        )
        inputs = {"in": (spec, grid(1000.0, 200), rng.normal(size=(200, 7)))}
        return [
            Case(cls(names, matrix, zero_v=(0.1,) * 6, origin_m=(0.0, 0.0, -0.04)), inputs, least=200),
            Case(cls(names[:1], ((1.0,), (0.0,), (50.0,), (0.0,), (2.0,), (0.0,)), min_force_N=0.0), inputs, least=200),
        ]
