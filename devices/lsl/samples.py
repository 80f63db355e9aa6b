"""Samples in the form in which LSL carries them: rows of one type of number, or texts; and the description that goes with them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, TypeAlias

import numpy as np

from kinegraph.devices.formats.xdf.writer import FORMATS, UNITS, type_of
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec
from kinegraph.stream.data.columns import MAX, column_names
from kinegraph.stream.errors import InputError, ParameterError, nearest

CHANNELS_SAID = 512
"""Streams with more channels are described without them: descriptions travel with every question on the network."""


@dataclass(frozen=True, slots=True)
class NumberRows:
    """A stream of numbers.

    labels    (name, unit) of every LSL channel
    dtype     what is sent
    fields    of an event, those that are sent; (): the samples are no events
    """

    spec: StreamSpec
    labels: list[tuple[str, str]]
    dtype: np.dtype[Any]
    fields: tuple[str, ...] = ()

    @property
    def format(self) -> str:
        return FORMATS[self.dtype.str]

    @property
    def type(self) -> str:
        return "Events" if self.fields else str(self.spec.meta.get("xdf_type") or "Signal")

    @property
    def rate_hz(self) -> float:
        return self.spec.rate_hz or 0.0

    def rows(self, chunk: Chunk) -> Array:
        """The samples (n, channels)."""
        if self.fields:
            return np.stack([_number(self.spec, chunk, field) for field in self.fields], axis=1)
        return np.asarray(chunk.data.reshape(len(chunk), -1), self.dtype)

    def describe(self, desc: Any, kind: str) -> None:
        """Write labels, units, and where it comes from, into LSL's description."""
        _describe(desc, self.labels, kind, None if self.fields else self.spec)


@dataclass(frozen=True, slots=True)
class Texts:
    """Events as texts, one a sample. `field`: the text field to send; "": all of them, in JSON."""

    spec: StreamSpec
    field: str = ""
    format = "string"
    type = "Markers"
    rate_hz = 0.0

    @property
    def labels(self) -> list[tuple[str, str]]:
        return [(self.field or "event", "")]

    def rows(self, chunk: Chunk) -> list[str]:
        """The texts (n)."""
        if self.field:
            return [_text(value) for value in chunk.data[self.field]]
        names = self.spec.channels
        return [json.dumps({name: _plain(event[name]) for name in names}, allow_nan=False) for event in chunk.data]

    def describe(self, desc: Any, kind: str) -> None:
        """Write labels, and where it comes from, into LSL's description."""
        _describe(desc, self.labels, kind, None)


Form: TypeAlias = NumberRows | Texts


def form_of(spec: StreamSpec, events: str, fields: tuple[str, ...]) -> Form:
    """How a stream is sent; raises InputError or ParameterError where it cannot be."""
    if not spec.is_event:
        if fields:
            raise ParameterError("fields", list(fields), f"left out: the input is not an event but {spec.describe()}")
        return _numbers(spec)
    for name in fields:
        if name not in spec.channels:
            raise ParameterError("fields", name, f"a field of the event; {nearest(name, spec.channels)}")
    if events == "json":
        if fields:
            raise ParameterError("fields", list(fields), "left out, or say `events: field` or `events: numbers`")
        return Texts(spec)
    if events == "field":
        if len(fields) != 1:
            raise ParameterError("fields", list(fields), f"one of the event's fields: {', '.join(spec.channels)}")
        return Texts(spec, fields[0])
    return _event_numbers(spec, fields or spec.channels)


def _numbers(spec: StreamSpec) -> NumberRows:
    size = int(np.prod(spec.shape, dtype=np.int64))
    if not 0 < size <= MAX:
        raise InputError(
            "in", f"{spec.describe()}: {size} numbers a sample", f"a stream of 1 to {MAX} numbers a sample"
        )
    dtype = type_of(spec)
    if dtype is None:
        raise InputError("in", spec.describe(), "a stream of real numbers")
    return NumberRows(spec, column_names(spec), dtype)


def _event_numbers(spec: StreamSpec, fields: tuple[str, ...]) -> NumberRows:
    for name in fields:
        field = spec.dtype[name]
        if field.shape or field.base.kind not in "fiub":
            raise ParameterError("fields", name, "a field that is one number; or say `events: json`")
    labels = [(name, "s" if spec.unit_of(name) == "ns" else spec.unit_of(name)) for name in fields]
    return NumberRows(spec, labels, np.dtype("<f8"), tuple(fields))


def _number(spec: StreamSpec, chunk: Chunk, field: str) -> Samples:
    """A field of events as numbers (n,); a time becomes seconds after the stamp, NaN where unknown."""
    values = chunk.data[field]
    if spec.unit_of(field) != "ns":
        return np.asarray(values, np.float64)
    return np.where(values > 0, (values - chunk.time) / NS, np.nan)


def _describe(desc: Any, labels: list[tuple[str, str]], kind: str, spec: StreamSpec | None) -> None:
    """XDF's conventions, and the spec, from which `kinegraph files import` makes the stream that it was."""
    if len(labels) <= CHANNELS_SAID:
        write_channels(desc, labels, kind)
    acquisition = desc.append_child("acquisition")
    acquisition.append_child_value("manufacturer", "kinegraph")
    acquisition.append_child_value("version", version("kinegraph"))
    if spec is not None:
        desc.append_child("kinegraph").append_child_value("spec", json.dumps(spec.to_json()))


def write_channels(desc: Any, labels: Sequence[tuple[str, str]], kind: str) -> None:
    """Write every channel's label, unit and type into LSL's description."""
    channels = desc.append_child("channels")
    for label, unit in labels:
        channel = channels.append_child("channel")
        channel.append_child_value("label", label)
        channel.append_child_value("unit", UNITS.get(unit, unit))
        channel.append_child_value("type", kind)


def _plain(value: Any) -> Any:
    """A field's value as JSON has it; what is no number is null."""
    plain = value.tolist()
    if isinstance(plain, list):
        return [_plain(part) for part in value]
    if isinstance(plain, bytes):
        return plain.decode("utf-8", "replace")
    if isinstance(plain, float) and not np.isfinite(plain):
        return None
    return plain


def _text(value: Any) -> str:
    plain = _plain(value)
    return plain if isinstance(plain, str) else json.dumps(plain)
