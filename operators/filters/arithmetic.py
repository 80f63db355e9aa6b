"""Arithmetic between the channels of a signal: sums, differences, means, magnitudes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.inputs.channels import find_channel, names_of
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

OPERATIONS = ("keep", "sum", "difference", "mean", "product", "ratio", "magnitude", "min", "max")
KEEP, SUM, DIFFERENCE, MEAN, PRODUCT, RATIO, MAGNITUDE, MIN, MAX = range(len(OPERATIONS))


@kernel
def combine(x: Samples, plan: Times, operands: Times, out: Samples) -> None:
    """Column k of `out` (n, m) is operation `plan[k, 0]` over those columns of `x` (n, c) that `operands[plan[k, 1] : plan[k, 2]]` name.

    NaN where an operand or the result is not finite.
    """
    for i in range(x.shape[0]):
        for k in range(plan.shape[0]):
            operation, first, last = plan[k, 0], plan[k, 1], plan[k, 2]
            v = x[i, operands[first]]
            fine = abs(v) < math.inf
            if operation == MAGNITUDE:
                v *= v
            for j in range(first + 1, last):
                w = x[i, operands[j]]
                fine = fine and abs(w) < math.inf
                if operation in (SUM, MEAN):
                    v += w
                elif operation == DIFFERENCE:
                    v -= w
                elif operation == PRODUCT:
                    v *= w
                elif operation == RATIO:
                    v /= w
                elif operation == MAGNITUDE:
                    v += w * w
                elif operation == MIN:
                    v = min(v, w)
                elif operation == MAX:
                    v = max(v, w)
            if operation == MEAN:
                v /= last - first
            elif operation == MAGNITUDE:
                v = math.sqrt(v)
            out[i, k] = finite(v) if fine else math.nan


@dataclass(slots=True)
class ArithmeticState:
    plan: Times
    operands: Times


@dataclass(frozen=True, slots=True)
class Arithmetic(SampleWise[ArithmeticState]):
    """New channels, each computed from some channels of the same sample. No delay; works at any rate, and passes gaps on as they are.

    compute  per new channel: the operation, then the channels it is done to, in order, as in `force: [sum, left, right]`
    keep     whether the input's channels come out as well, before the new ones

    sum, mean, min, max, product and magnitude (the root of the sum of squares) take one channel or more, difference and ratio two: the
    first less, or over, the second. All but product and ratio need channels of one unit. What is not finite in, or not defined (0 / 0),
    is NaN. Channels of different streams are joined by operators.timing.align.Align first.

    >>> Arithmetic(compute={"norm": ["magnitude", "x", "y"]})(np.array([[3.0, 4.0]]), rate_hz=100, channels=["x", "y"])
    array([[5.]])
    """

    compute: Mapping[str, tuple[str, ...]] = param(help="new channel: [operation, channel, channel, ...]")
    keep: bool = param(False, help="keep the input's channels too")

    kernel = combine

    def begin(self, spec: StreamSpec) -> ArithmeticState:
        if not spec.is_signal:
            raise InputError("in", spec.describe(), "a signal of channels")
        if not self.compute:
            raise ParameterError("compute", self.compute, "at least one new channel: {name: [operation, channel, ...]}")
        kept = self._kept(spec)
        plan: list[tuple[int, int, int]] = []
        operands: list[int] = []
        for code, given in [(KEEP, [i]) for i in range(len(kept))] + [self._read(spec, name) for name in self.compute]:
            plan.append((code, len(operands), len(operands) + len(given)))
            operands += given
        for name in self.compute:
            if name in kept:
                raise ParameterError("compute", name, "a name that no kept channel has")
        return ArithmeticState(np.array(plan, np.int64), np.array(operands, np.int64))

    def gives(self, spec: StreamSpec) -> StreamSpec:
        kept = self._kept(spec)
        units = [spec.units[i % len(spec.units)] for i in range(len(kept))]
        units += [self._unit(spec, name) for name in self.compute]
        channels = (*kept, *self.compute)
        return spec.derive(shape=(len(channels),), channels=channels, units=tuple(units))

    def _kept(self, spec: StreamSpec) -> tuple[str, ...]:
        return names_of(spec) if self.keep else ()

    def _read(self, spec: StreamSpec, name: str) -> tuple[int, list[int]]:
        """A new channel's operation, and the places of its operands."""
        parameter = f"compute.{name}"
        if not self.compute[name] or self.compute[name][0] not in OPERATIONS[1:]:
            given = self.compute[name][0] if self.compute[name] else None
            hint = nearest(given, OPERATIONS[1:]) if given else f"operations are {', '.join(OPERATIONS[1:])}"
            raise ParameterError(parameter, given, f"a list that begins with an operation; {hint}")
        operation, *channels = self.compute[name]
        if operation in ("difference", "ratio") and len(channels) != 2:
            raise ParameterError(parameter, channels, f"two channels, as a {operation} is of two")
        if not channels:
            raise ParameterError(parameter, channels, f"at least one channel to take the {operation} of")
        return OPERATIONS.index(operation), [find_channel(spec, channel, parameter) for channel in channels]

    def _unit(self, spec: StreamSpec, name: str) -> str:
        operation, *channels = self.compute[name]
        units = [spec.units[find_channel(spec, channel, "") % len(spec.units)] for channel in channels]
        if operation == "product":
            return " ".join(unit for unit in units if unit)
        if operation == "ratio":
            return "" if units[0] == units[1] else f"{units[0] or '1'}/{units[1]}" if units[1] else units[0]
        if len(set(units)) > 1:
            raise ParameterError(f"compute.{name}", channels, f"channels of one unit, not {', '.join(units)}")
        return units[0]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        spec = StreamSpec((3,), rate_hz=100.0, channels=("x", "y", "z"), units=("g",))
        inputs = {"in": (spec, grid(100.0, 200), np.random.default_rng(12).normal(size=(200, 3)))}
        every = {name: (name, "x", "y") for name in OPERATIONS[1:]}
        return [
            Case(cls({"length": ("magnitude", "x", "y", "z")}, keep=True), inputs, least=200),
            Case(cls(every), inputs, least=200),
        ]
