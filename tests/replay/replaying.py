"""What the files of this folder share: arrays made streams, and plain signal processing by scipy to hold the graphs against."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt, sosfiltfilt

import kinegraph as kg
from stream.chunk import NS, Array

ONSET = np.dtype([("onset", "<i8")])


def signal(
    data: Array,
    rate_hz: float | None,
    channels: Iterable[str] = (),
    units: Sequence[str] = (),
    *,
    time_s: Array | None = None,
    start_s: float = 0.0,
    **meta: Any,
) -> kg.Series:
    """Samples (n, ...) as a stream; stamps are `time_s`, or run evenly from `start_s`."""
    seconds = start_s + np.arange(len(data)) / (rate_hz or 1.0) if time_s is None else time_s
    data = np.ascontiguousarray(data, data.dtype if data.dtype == np.uint16 else np.float64)
    spec = kg.StreamSpec(data.shape[1:], data.dtype, rate_hz, tuple(channels), tuple(units) or ("",), meta=meta)
    return kg.Series("", spec, np.round(seconds * NS).astype(np.int64), data)


def events(seconds: Sequence[float] | Array, **meta: Any) -> kg.Series:
    """Moments as a stream of events, each stamped when it happens."""
    onset = np.round(np.asarray(seconds, float) * NS).astype(np.int64)
    return kg.Series("", kg.StreamSpec((), ONSET, units=("ns",), meta=meta), onset, onset.view(ONSET))


def emg_envelope(emg: Array, rate_hz: float, cutoff_hz: float = 20.0) -> Array:
    """The textbook envelope of raw EMG (n, c): high-pass 20 Hz, rectify, low-pass; both filters forth and back."""
    high = butter(2, 20.0, "highpass", fs=rate_hz, output="sos")
    low = butter(4, cutoff_hz, fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(low, np.abs(sosfiltfilt(high, emg, axis=0)), axis=0))


def highpassed(emg: Array, rate_hz: float) -> Array:
    """Raw EMG (n, c) without the electrodes' offset: a Butterworth high-pass of 20 Hz, fourth order, once."""
    return np.asarray(sosfilt(butter(4, 20.0, "highpass", fs=rate_hz, output="sos"), emg, axis=0))


def at(series: kg.Series, seconds: Array, values: Array) -> Array:
    """A reference `values` (n, c) at `seconds`, read at a stream's own stamps."""
    own = series.time / NS
    return np.stack([np.interp(own, seconds, column) for column in np.reshape(values, (len(values), -1)).T], axis=1)
