"""Choosing, ordering and naming the channels of a stream."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.inputs.channels import find_channel, names_of
from kinegraph.stream.chunk import Array, StreamSpec, Times
from kinegraph.stream.data.require import width_of
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, grid
from kinegraph.stream.params import param


@kernel
def gather(x: Array, wanted: Times, out: Array) -> None:
    """Columns `wanted` (m,) of `x` (n, c) into `out` (n, m)."""
    for i in range(x.shape[0]):
        for k in range(wanted.shape[0]):
            out[i, k] = x[i, wanted[k]]


@dataclass(slots=True)
class SelectState:
    """`wanted`: the places of the numbers that come out, in a sample laid flat."""

    wanted: Times


@dataclass(frozen=True, slots=True)
class Select(SampleWise[SelectState]):
    """Some of a stream's channels, in the order given, under new names if wanted. Values pass as they are, bad ones too; no delay.

    channels  names, or numbers from 0 where a stream has no names (then its channels are called "0", "1", ...); empty: all
    rename    new names by old ones

    Takes signals and markers (with points as channels) of any dtype, and keeps the dtype.

    >>> Select(channels=["SO"])(np.array([[1.0, 2.0], [3.0, 4.0]]), rate_hz=100, channels=["TA", "SO"])
    array([[2.],
           [4.]])
    """

    channels: tuple[str | int, ...] = param((), help="names, or numbers from 0; empty: all")
    rename: Mapping[str, str] | None = param(None, help="new names by old ones")
    kernel = gather
    keeps_dtype = True
    inputs = {"in": Input()}

    def begin(self, spec: StreamSpec) -> SelectState:
        if spec.is_event or not spec.shape:
            raise InputError("in", spec.describe(), "a stream with channels (a signal or markers)")
        places = np.arange(width_of(spec)).reshape(spec.shape)
        return SelectState(places.take(self._wanted(spec), axis=spec.channel_axis).ravel())

    def gives(self, spec: StreamSpec) -> StreamSpec:
        names, wanted, axis = names_of(spec), self._wanted(spec), spec.channel_axis
        shape = (*spec.shape[:axis], len(wanted), *spec.shape[axis + 1 :])
        units = spec.units if len(spec.units) == 1 else tuple(spec.units[i] for i in wanted)
        return spec.derive(shape=shape, channels=self._renamed(tuple(names[i] for i in wanted)), units=units)

    def _wanted(self, spec: StreamSpec) -> list[int]:
        wanted = [find_channel(spec, given, "channels") for given in self.channels]
        if len(set(wanted)) < len(wanted):
            raise ParameterError("channels", list(self.channels), "a list that names no channel twice")
        return wanted or list(range(len(names_of(spec))))

    def _renamed(self, chosen: tuple[str, ...]) -> tuple[str, ...]:
        new = self.rename or {}
        for old in new:
            if old not in chosen:
                raise ParameterError(
                    "rename", new, f"names by chosen channels; there is no {old!r}, {nearest(old, chosen)}"
                )
        names = tuple(new.get(name, name) for name in chosen)
        for name in names:
            if names.count(name) > 1:
                raise ParameterError("rename", new, f"names that differ; {name!r} would be there twice")
        return names

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(11)
        spec = StreamSpec((3,), rate_hz=100.0, channels=("x", "y", "z"), units=("g",))
        inputs: dict[str, Any] = {"in": (spec, grid(100.0, 200), rng.normal(size=(200, 3)))}
        points = StreamSpec((4, 3), np.dtype(np.float32), 50.0, channels=("hip", "knee", "ankle", "toe"), units=("m",))
        return [
            Case(cls(channels=("z", "x"), rename={"z": "up"}), inputs, least=200),
            Case(
                cls(channels=("toe", 1)),
                {"in": (points, grid(50.0, 200), rng.normal(size=(200, 4, 3)).astype(np.float32))},
                least=200,
            ),
        ]
