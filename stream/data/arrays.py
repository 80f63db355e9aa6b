"""Arrays as streams: their stamps and spec."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, StreamSpec, Times, grid, stamps
from kinegraph.stream.data.series import Series
from kinegraph.stream.errors import InputError, KinegraphError


def series(
    data: Any,
    *,
    name: str = "in",
    rate_hz: float | None = None,
    time: Any = None,
    channels: Sequence[str] = (),
    units: Sequence[str] = ("",),
    spec: StreamSpec | None = None,
) -> Series:
    """An array (n,) or (n, *shape) as a stream.

    spec   what its samples must be, where that is known; then `channels` and `units` are taken from there, and the rate if not given
    time   (n,) int64 ns; left out: from `rate_hz`, which a stream without stamps needs. Steps of a regular stream's stamps that are
           longer than one and a half periods are gaps
    """
    array = np.asarray(data)
    if array.ndim == 1 and not array.dtype.names:
        array = array[:, None]
    if array.ndim == 0 or not (array.dtype.names or array.dtype.kind in "iufb"):
        raise InputError(
            name, f"a {type(data).__name__} of {array.dtype}", "an array (n, channels) of numbers, or of events"
        )
    if spec is not None:
        if spec.shape != array.shape[1:]:
            raise InputError(
                name, f"samples of shape {array.shape[1:]}", f"{spec.describe()}, samples of shape {spec.shape}"
            )
        made = spec.derive(dtype=array.dtype, rate_hz=spec.rate_hz if rate_hz is None else rate_hz)
    else:
        made = StreamSpec(array.shape[1:], array.dtype, rate_hz, tuple(channels), tuple(units))
    if time is None:
        if made.rate_hz is None:
            raise KinegraphError(f"{name}: how fast were these samples taken? Give rate_hz=1000, or time= (int64 ns)")
        return Series(name, made, grid(made.rate_hz, len(array)), array)
    stamped = stamps(time, name)
    if len(stamped) != len(array):
        raise KinegraphError(f"{name}: {len(stamped)} stamps for {len(array)} samples")
    if np.any(np.diff(stamped) < 0):
        raise KinegraphError(f"{name}: time runs backwards at sample {int(np.argmax(np.diff(stamped) < 0)) + 1}")
    return Series(name, made, stamped, array, _gaps(stamped, made))


def _gaps(time: Times, spec: StreamSpec) -> Array | None:
    """How many samples are missing before each (n,), by a regular stream's stamps; None: nothing is missing."""
    if spec.rate_hz is None or len(time) < 2:
        return None
    missing = np.concatenate([[0], np.round(np.diff(time) * (spec.rate_hz / 1e9)).astype(np.int64) - 1])
    return np.maximum(missing, 0) if (missing > 0).any() else None
