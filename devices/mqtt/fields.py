"""What is reported of a stream: which one, which field, which events; and a value as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, Specs, StreamSpec, utc
from kinegraph.stream.errors import ParameterError, nearest


def stream_of(specs: Specs, of: str, parameter: str) -> StreamSpec:
    if of not in specs:
        raise ParameterError(parameter, of, f"a stream that this outlet reads; {nearest(of, list(specs))}")
    return specs[of]


def check_field(spec: StreamSpec, field: str, parameter: str) -> None:
    if field and field not in spec.channels:
        raise ParameterError(parameter, field, f"a field of the stream; {nearest(field, list(spec.channels))}")
    if not spec.is_event and len(spec.shape) != 1:
        raise ParameterError(parameter, field, f"a channel of a signal or a field of events, not of {spec.describe()}")


def check_where(spec: StreamSpec, where: dict[str, Any] | None, parameter: str) -> None:
    for field in where or {}:
        if not spec.is_event:
            raise ParameterError(parameter, field, "left out of a signal")
        check_field(spec, field, parameter)


def chosen(rows: Array, where: dict[str, Any] | None) -> Array:
    """Which events are meant (n,) bool."""
    chosen = np.ones(len(rows), np.bool_)
    for field, value in (where or {}).items():
        chosen &= rows[field] == value
    return chosen


def as_json(value: Any, unit: str) -> Any:
    """A field for JSON: times as ISO 8601, what is not known as null."""
    if unit == "ns":
        return utc(int(value)) if value > 0 else None
    plain = value.item() if isinstance(value, np.generic) else value.tolist()
    return None if isinstance(plain, float) and not np.isfinite(plain) else plain
