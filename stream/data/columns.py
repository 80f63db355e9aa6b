"""A stream's samples as plain columns: what tables and XDF need of signals, markers and events."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from kinegraph.stream.chunk import Array, StreamSpec
from kinegraph.stream.errors import RecordingError

MAX = 4096
"""A sample with more numbers than this is no row of a table."""


def column_names(spec: StreamSpec) -> list[tuple[str, str]]:
    """(name, unit) of every number of a sample: a channel, a marker's coordinate ("LANK.x"), an event's field ("curve[3]")."""
    if spec.is_event:
        assert spec.dtype.names is not None
        return [
            (f"{name}{_index(i)}", spec.unit_of(name))
            for name in spec.dtype.names
            for i in np.ndindex(spec.dtype[name].shape)
        ]
    if np.prod(spec.shape, dtype=np.int64) > MAX:
        raise RecordingError(f"samples of {' x '.join(map(str, spec.shape))} numbers do not fit into a table")
    axes = [[_index((i,)) for i in range(n)] for n in spec.shape]
    if spec.channels:
        axes[spec.channel_axis] = list(spec.channels)
        if len(spec.shape) == 2 and spec.shape[1] == 3 and spec.channel_axis == 0:
            axes[1] = [".x", ".y", ".z"]
    elif len(spec.shape) == 1:
        axes = [[f"channel{i + 1}" for i in range(spec.shape[0])]]
    names = ["".join(_channel_first(parts, spec)) or "value" for parts in product(*axes)]
    units = [spec.units[0]] * len(names) if len(spec.units) == 1 else _spread(spec)
    return list(zip(names, units, strict=True))


def _channel_first(parts: tuple[str, ...], spec: StreamSpec) -> tuple[str, ...]:
    axis = spec.channel_axis
    return (parts[axis], *parts[:axis], *parts[axis + 1 :]) if spec.channels else parts


def _spread(spec: StreamSpec) -> list[str]:
    """The channels' units, for every number of a sample."""
    units = np.array(spec.units, object).reshape(
        [-1 if axis == spec.channel_axis else 1 for axis in range(len(spec.shape))]
    )
    return [str(unit) for unit in np.broadcast_to(units, spec.shape).ravel()]


def _index(place: tuple[int, ...]) -> str:
    return "".join(f"[{i}]" for i in place)


def columns(spec: StreamSpec, data: Array) -> list[Array]:
    """The columns (n,) of samples (n, *shape), in the order of `column_names`."""
    if not spec.is_event:
        flat = data.reshape(len(data), int(np.prod(data.shape[1:])))
        return [flat[:, i] for i in range(flat.shape[1])]
    assert spec.dtype.names is not None
    return [data[name][(slice(None), *i)] for name in spec.dtype.names for i in np.ndindex(spec.dtype[name].shape)]


def assemble(spec: StreamSpec, parts: Sequence[Array]) -> Array:
    """Samples (n, *shape) from the columns that `columns` gave, numbers or texts of them. Raises ValueError where they do not fit."""
    n = len(parts[0])
    if not spec.is_event:
        return np.ascontiguousarray(np.stack(parts, axis=1).reshape(n, *spec.shape), spec.dtype)
    data = np.zeros(n, spec.dtype)
    names = iter(parts)
    for name in spec.dtype.names or ():
        field = spec.dtype[name]
        for i in np.ndindex(field.shape):
            values = next(names)
            data[name][(slice(None), *i)] = (
                [v == "True" for v in values] if field.base.kind == "b" and values.dtype.kind in "UO" else values
            )
    return data
