"""Samples as messages to the page."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from kinegraph.devices.page.transfer.catalogue import kind_of, scalar_fields
from kinegraph.devices.page.transfer.downsample import Curve
from kinegraph.devices.page.transfer.poses import bones_of, places
from kinegraph.devices.page.transfer.wire import encode
from kinegraph.stream.chunk import Array, StreamSpec, Times

MOST_ROWS = 2000
"""Events in one message."""
PLAUSIBLE = 1 << 59
"""A number of nanoseconds above this is a time, below it a duration."""


def seconds(time: Times, t0_ns: int) -> Array:
    """Stamps in s since `t0_ns`."""
    return (time - t0_ns) / 1e9


def signal(number: int, curve: Curve, width_ns: int, t0_ns: int, **more: Any) -> bytes:
    """A signal's newest points: times in float64, then the least values, then (thinned out) the greatest, each channel by channel."""
    header = {"t": "signal", "s": number, "n": len(curve.time), "w": width_ns / 1e9, **more}
    parts = [curve.low] if curve.high is None else [curve.low, curve.high]
    header["thin"] = curve.high is not None
    return encode(header, seconds(curve.time, t0_ns).tobytes(), *(np.ascontiguousarray(p.T).tobytes() for p in parts))


def events(number: int, first: int, spec: StreamSpec, time: Times, data: Array, t0_ns: int, **more: Any) -> bytes:
    """Events as rows: the stamp (s), then the fields that are one number or text each."""
    fields = scalar_fields(spec)
    is_time = [spec.unit_of(f) == "ns" for f in fields]
    rows = [
        [(int(stamp) - t0_ns) / 1e9, *(_plain(event[f], at, t0_ns) for f, at in zip(fields, is_time, strict=True))]
        for stamp, event in zip(time, data, strict=True)
    ]
    return encode({"t": "events", "s": number, "first": first, "rows": rows, **more})


def _plain(value: Any, is_time: bool, t0_ns: int) -> Any:
    value = value.item()
    if is_time and isinstance(value, int):
        return (value - t0_ns) / 1e9 if value > PLAUSIBLE else value / 1e9
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return None if isinstance(value, float) and not isfinite(value) else value


def completed(samples: Array) -> Array:
    """The last of some curves (n, points, c), where a channel that it lacks (one of another limb) is that of the last curve that has it."""
    made: Array = samples[-1].copy()
    for earlier in samples[-2::-1]:
        lacking = np.isnan(made).all(axis=0)
        if not lacking.any():
            break
        made[:, lacking] = earlier[:, lacking]
    return made


def newest(number: int, spec: StreamSpec, count: int, stamp: int, sample: Array, t0_ns: int) -> bytes:
    """One sample that is shown as a whole: a frame, points, a mesh or a bundle of curves; `count` is its running number."""
    turns = b""
    if skeleton := bones_of(spec):
        turns, sample = np.ascontiguousarray(sample[3:], "<f4").tobytes(), places(skeleton, sample)
    header: dict[str, Any] = {
        "t": "points" if skeleton else kind_of(spec),
        "s": number,
        "at": (stamp - t0_ns) / 1e9,
        "count": count,
    }
    header["shape"] = [*sample.shape]
    if header["t"] == "mesh" and np.isfinite(sample).all():
        low, high = sample.min(axis=0), sample.max(axis=0)
        header |= {"low": low.tolist(), "high": high.tolist(), "type": "u2"}
        scale = 65535 / np.maximum(high - low, 1e-9)
        return encode(header, ((sample - low) * scale).round().astype("<u2").tobytes())
    header["type"] = "u2" if sample.dtype == np.uint16 else "f4"
    return encode(header, np.ascontiguousarray(sample, "<u2" if header["type"] == "u2" else "<f4").tobytes(), turns)
