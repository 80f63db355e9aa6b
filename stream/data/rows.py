"""What an input port may ask for: samples as contiguous rows of float64, made once per edge however many of its readers ask."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.inputs import Input, input_of
from kinegraph.stream.data.require import width_of
from kinegraph.stream.kernel import kernel


class HasInputs(Protocol):
    """An operator, as far as its inputs go."""

    @property
    def inputs(self) -> Mapping[str, Input]: ...


class Rows:
    """Chunks of a stream as rows of float64 (n, width), in C order; `finite`: what is not a finite number in them is NaN.

    The newest chunk's rows are kept for the next who asks for them. Where nothing is to be changed, the chunk itself is given back.
    """

    __slots__ = ("_convert", "_finite", "_made", "_width")

    def __init__(self, spec: StreamSpec, *, finite: bool) -> None:
        self._width, self._convert = width_of(spec), not _are_rows(spec)
        self._finite = finite and spec.dtype.kind == "f"
        self._made: tuple[Chunk, Chunk] | None = None
        if self._finite and not all_finite(np.full((1, 1), np.nan)):  # nothing is left to compile once samples come
            quieted(np.zeros((1, 1)), np.empty((1, 1)))

    def __call__(self, chunk: Chunk) -> Chunk:
        if self._made and self._made[0] is chunk:
            return self._made[1]
        data = chunk.data
        if self._convert:
            data = np.ascontiguousarray(data, np.float64).reshape(len(data), self._width)
        if self._finite and not all_finite(data):
            data = quieted(data, np.empty(data.shape))
        if data is chunk.data:
            return chunk
        made = Chunk(chunk.time, data, chunk.until, chunk.lost)
        self._made = chunk, made
        return made


def rows_for(port: Input, spec: StreamSpec, made: dict[bool, Rows]) -> Rows | None:
    """What brings an edge's chunks into the form that a port asks for; None: they have it. `made`: what the edge has already."""
    if not (port.rows or port.finite) or spec.is_event or spec.dtype.kind not in "iufb":
        return None
    asks = port.finite and spec.dtype.kind == "f"
    return made.setdefault(asks, Rows(spec, finite=asks)) if asks or not _are_rows(spec) else None


def taking(operator: HasInputs, specs: Specs) -> Callable[[str, Chunk], Chunk]:
    """For whoever calls an operator's `process` without a graph: brings a port's chunk into the form that the operator asks for."""
    by_port = {port: rows_for(input_of(operator.inputs, port), spec, {}) for port, spec in specs.items()}

    def take(port: str, chunk: Chunk) -> Chunk:
        rows = by_port[port]
        return rows(chunk) if rows else chunk

    return take


@kernel
def all_finite(x: Samples) -> bool:
    """Whether every number of `x` (n, c) is finite."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            if np.isnan(finite(x[i, c])):
                return False
    return True


@kernel
def quieted(x: Samples, out: Samples) -> Samples:
    """`x` (n, c) with NaN for what is not finite, in `out` (n, c)."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = finite(x[i, c])
    return out


def _are_rows(spec: StreamSpec) -> bool:
    return spec.is_signal and spec.dtype == np.float64
