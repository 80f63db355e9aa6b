"""Checks of input streams that operators share, with one wording of each error."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, ParameterError


def width_of(spec: StreamSpec) -> int:
    """How many numbers a sample holds."""
    return int(np.prod(spec.shape, dtype=np.int64))


def numeric(spec: StreamSpec, port: str = "in") -> StreamSpec:
    """The spec, if its samples are numbers; as an output it is float64."""
    if spec.is_event or spec.dtype.kind not in "iufb":
        raise InputError(port, spec.describe(), "a stream of numbers (a signal, markers or frames), not of events")
    return spec.derive(dtype=np.dtype(np.float64))


def regular(spec: StreamSpec, port: str = "in") -> float:
    """The rate in Hz of a regular stream."""
    if spec.rate_hz is None:
        raise InputError(
            port,
            spec.describe(),
            "regular: its rate must be known; join it to a regular stream with operators.timing.align.Align",
        )
    return spec.rate_hz


def regular_signal(spec: StreamSpec, port: str = "in", kind: str = "a signal") -> float:
    """The rate in Hz of a signal: a regular stream of numbers in channels."""
    if not spec.is_signal or spec.rate_hz is None or spec.dtype.kind not in "iuf":
        raise InputError(port, spec.describe(), f"{kind} of channels at a regular rate")
    return spec.rate_hz


def samples_in(parameter: str, seconds: float, rate_hz: float) -> int:
    """How many samples a window of `seconds` holds, rounded; at least one."""
    n = round(seconds * rate_hz)
    if n < 1:
        raise ParameterError(parameter, seconds, f"at least {1 / rate_hz:g} (one sample at {rate_hz:g} Hz)")
    return n
