"""What flows: a stream's fixed spec, and chunks of consecutive samples under it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.errors import InputError
from kinegraph.stream.text.time_text import rate

Samples: TypeAlias = NDArray[np.float64]
Times: TypeAlias = NDArray[np.int64]
Array: TypeAlias = NDArray[Any]

NS = 1_000_000_000
STAMP = np.dtype(np.int64)
"""What stamps are; `np.empty(n, STAMP)` is quicker than with the type's name."""
FOREVER = np.iinfo(np.int64).max
"""The `until` of a stream that has ended."""
NEVER = np.iinfo(np.int64).min
"""The `until` of a stream of which nothing is known yet."""
MAX_AXES = 8
MIN_RATE_HZ, MAX_RATE_HZ = 1e-9, 1e9
"""Slower ones have a period of decades, faster ones one of less than a nanosecond."""


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """What every sample of a stream is; fixed while a graph runs.

    shape         of one sample: (channels,) signal, (height, width) frame, (points, 3) markers, () event
    dtype         of one sample's numbers; a structured dtype makes an event
    rate_hz       nominal rate; None: irregular
    channels      names along `channel_axis` of a sample; an event's channels are its fields
    units         one per channel, or a single one for all, e.g. ("uV",); "" means dimensionless
    settling_s    for how long after a start, or after a gap long enough to reset what made the stream, values are not settled
    meta          free, JSON-like facts that travel with the stream (normalisation, sensor site, ...)
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float64))
    rate_hz: float | None = None
    channels: tuple[str, ...] = ()
    units: tuple[str, ...] = ("",)
    channel_axis: int = 0
    settling_s: float = 0.0
    meta: dict[str, Any] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        """For notebooks: what a sample is, and its channels with their units."""
        from kinegraph.stream.text.html import table_html

        units = self.units if len(self.units) == len(self.channels) else self.units[:1] * len(self.channels)
        rows = [(name, units[i] if i < len(units) else "") for i, name in enumerate(self.channels)]
        return table_html((self.describe(), ""), rows)

    def __post_init__(self) -> None:
        object.__setattr__(self, "dtype", np.dtype(self.dtype))
        if self.dtype.names and not self.channels:
            object.__setattr__(self, "channels", tuple(self.dtype.names))
        if self.rate_hz is not None and not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ValueError(f"rate_hz is {self.rate_hz}; it must be positive, or None for an irregular stream")
        if self.rate_hz is not None and not MIN_RATE_HZ <= self.rate_hz <= MAX_RATE_HZ:
            raise ValueError(f"rate_hz is {self.rate_hz}; it must be from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz")
        if len(set(self.channels)) != len(self.channels):
            raise ValueError(f"channel names must differ, got {', '.join(self.channels)}")
        if self.channels and not self.dtype.names and self.shape[self.channel_axis] != len(self.channels):
            raise ValueError(f"{len(self.channels)} channel names for a sample of shape {self.shape}")
        if len(self.units) not in (1, len(self.channels)):
            raise ValueError(f"{len(self.units)} units for {len(self.channels)} channels")

    @property
    def is_event(self) -> bool:
        return self.dtype.names is not None

    @property
    def is_signal(self) -> bool:
        """Whether samples are rows of numeric channels."""
        return not self.is_event and len(self.shape) == 1

    @property
    def period_ns(self) -> int:
        """Nominal time between samples in ns; 0 if irregular."""
        return round(NS / self.rate_hz) if self.rate_hz else 0

    @property
    def sample_bytes(self) -> int:
        return int(self.dtype.itemsize * np.prod(self.shape, dtype=np.int64))

    def unit_of(self, channel: str) -> str:
        return self.units[0] if len(self.units) == 1 else self.units[self.channels.index(channel)]

    def derive(self, **changes: Any) -> StreamSpec:
        """The spec of a stream computed from this one. What has another shape is no longer the mesh that `meta`
        describes (stream.domain.mesh)."""
        made = replace(self, **changes)
        if made.shape == self.shape or "mesh" not in made.meta or made.meta["mesh"] is not self.meta.get("mesh"):
            return made
        return replace(made, meta={key: value for key, value in made.meta.items() if key != "mesh"})

    def describe(self) -> str:
        """One line for people: "13 channels float64 at 1000 Hz in uV"."""
        kind = (
            f"events ({', '.join(self.channels)})"
            if self.is_event
            else f"{self.shape[0]} channel{'s' if self.shape[0] != 1 else ''} {self.dtype}"
            if self.is_signal
            else f"{' x '.join(map(str, self.shape))} {self.dtype}"
        )
        at = f" at {rate(self.rate_hz)} Hz" if self.rate_hz else ", irregular"
        unit = (
            ""
            if self.is_event or not any(self.units)
            else f" in {', '.join(dict.fromkeys(u or 'no unit' for u in self.units))}"
        )
        return kind + at + unit

    def to_json(self) -> dict[str, Any]:
        return {
            "shape": list(self.shape),
            "dtype": np.lib.format.dtype_to_descr(self.dtype),
            "rate_hz": self.rate_hz,
            "channels": list(self.channels),
            "units": list(self.units),
            "channel_axis": self.channel_axis,
            "settling_s": self.settling_s,
            "meta": self.meta,
        }

    @staticmethod
    def from_json(record: dict[str, Any]) -> StreamSpec:
        """What `to_json` gave. Raises ValueError, KeyError or TypeError for what cannot be a spec."""
        descr = record["dtype"]
        if not isinstance(descr, str):
            descr = [tuple(tuple(part) if isinstance(part, list) else part for part in f) for f in descr]
        dtype, shape = np.lib.format.descr_to_dtype(descr), tuple(record["shape"])
        if dtype.hasobject or not all(isinstance(n, int) and n >= 0 for n in shape) or len(shape) > MAX_AXES:
            raise ValueError(f"samples of shape {shape} and type {dtype} are impossible")
        return StreamSpec(
            shape=shape,
            dtype=dtype,
            rate_hz=record["rate_hz"],
            channels=tuple(record["channels"]),
            units=tuple(record["units"]),
            channel_axis=record["channel_axis"],
            settling_s=record["settling_s"],
            meta=record["meta"],
        )


Specs: TypeAlias = dict[str, StreamSpec]


class Chunk(msgspec.Struct, eq=False, gc=False):
    """Some consecutive samples of a stream; the arrays are never written again once it has been emitted.

    time   (n,) int64    nanoseconds of session time (UTC), one per sample, never decreasing
    data   (n, *shape)   the samples
    until  int           the stream is complete up to and including this time (ns): no later chunk holds a sample at or before it
    lost   int           how many samples are missing just before this chunk; 0: no sample, -1: an unknown number

    A chunk may be empty and still advance `until`; that is how time passes where nothing happens.
    """

    time: Times
    data: Array
    until: int
    lost: int = 0

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return f"Chunk({len(self.time)} samples, until={self.until}, lost={self.lost})"

    def part(self, start: int, stop: int) -> Chunk:
        """Samples start..stop-1; what holds the first sample keeps `lost`, what holds the last one keeps `until`."""
        until = self.until if stop >= len(self.time) else min(self.until, int(self.time[stop]) - 1)
        lost = self.lost if start == 0 and (stop > 0 or not len(self.time)) else 0
        return Chunk(self.time[start:stop], self.data[start:stop], until, lost)


def empty(spec: StreamSpec, until: int, lost: int = 0) -> Chunk:
    """A chunk without samples: only time passes."""
    return Chunk(np.empty(0, np.int64), np.empty((0, *spec.shape), spec.dtype), until, lost)


def grid(rate_hz: float, n: int, start_ns: int = NS) -> Times:
    """Stamps of `n` samples at `rate_hz`, from an index and an anchor, never by accumulation. Returns (n,) int64 ns."""
    return start_ns + np.round(np.arange(n) * (1e9 / rate_hz)).astype(np.int64)


def stamps(time: Any, name: str) -> Times:
    """Times (n,) as stamps; raises InputError for what is not whole nanoseconds."""
    array = np.asarray(time)
    if array.dtype.kind == "M":
        return array.astype("datetime64[ns]").astype(np.int64)
    if array.dtype.kind == "f":
        given = f"stamped in {array.dtype}, which cannot hold nanoseconds since 1970"
        raise InputError(
            name, given, "stamped in int64 ns; multiply seconds by 1e9: np.round(time * 1e9).astype(np.int64)"
        )
    if array.dtype.kind not in "iu" or array.ndim != 1:
        raise InputError(
            name, f"stamped with {array.dtype} of shape {array.shape}", "stamped in int64 ns, one per sample"
        )
    return array.astype(np.int64)


def add_lost(first: int, then: int) -> int:
    """The sum of two `lost` numbers, where -1 stands for an unknown number."""
    return -1 if first < 0 or then < 0 else first + then


def utc(time: int) -> str:
    """A stamp for people: "2026-11-21T01:02:03.456789Z"."""
    if not 0 <= time < 2**62:
        return "the end of time" if time > 0 else "before time"
    return f"{np.datetime64(time, 'ns').astype('datetime64[us]')}Z"
