"""Streams on the Lab Streaming Layer, with the declaration that reads each."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from kinegraph.devices.discovery.finders import FoundDevice
from kinegraph.devices.lsl.find import everything
from kinegraph.devices.lsl.metadata import TEXT, Described, describe
from kinegraph.devices.lsl.network import library
from kinegraph.stream.errors import DeviceError

ANSWER_S = 1.0
"""How long a stream may take to describe itself."""
MAX_LABELS = 64
"""A stream with more channels is declared by their number."""


def find() -> Iterator[FoundDevice]:
    """Every stream that answers within a second."""
    lsl = library()
    for info in everything(lsl):
        described = _described(lsl, info)
        if described is None:
            yield FoundDevice(
                "lsl", info.name(), "an LSL stream", note="it is announced, but does not answer; a firewall?"
            )
        else:
            yield FoundDevice("lsl", described.name, _what(described), yaml_of(described), _note(described))


def yaml_of(d: Described) -> str:
    """The node that reads a stream."""
    known = {"name": d.name, "type": d.type, "source_id": d.source_id}
    lines = ["use: devices.lsl.LslInlet", *(f"{key}: {json.dumps(value)}" for key, value in known.items() if value)]
    if d.format == TEXT:
        lines.append("markers: true")
        lines += [f"channels: {d.count}"] if d.count > 1 else []
        return "\n".join(lines)
    lines.append(f"channels: {json.dumps(list(d.labels)) if 0 < len(d.labels) <= MAX_LABELS else d.count}")
    if d.rate_hz:
        lines.append(f"rate_hz: {d.rate_hz:.12g}")
    if any(d.units):
        lines.append(f"unit: {json.dumps(d.units[0] if len(d.units) == 1 else list(d.units))}")
    return "\n".join(lines)


def _described(lsl: Any, info: Any) -> Described | None:
    inlet = lsl.StreamInlet(info, recover=False)
    try:
        return describe(inlet.info(ANSWER_S).as_xml())
    except (RuntimeError, DeviceError):
        return None


def _what(d: Described) -> str:
    rate = f"at {d.rate_hz:.12g} Hz" if d.rate_hz else "irregular"
    kind = "texts" if d.format == TEXT else f"{d.count} channel{'s' * (d.count != 1)} {d.format}"
    facts = f" ({', '.join(f'{key} {value}' for key, value in d.device)})" if d.device else ""
    return f"{d.type or 'untyped'}: {kind}, {rate}, on {d.host}{facts}"


def _note(d: Described) -> str:
    return "" if d.source_id else "it has no source_id: it is not found again by LSL itself after a restart"
