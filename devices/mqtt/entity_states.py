"""The states of entities, sent when they change or are about to expire."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from kinegraph.devices.mqtt.discovery import OFF, ON, UNKNOWN, Entity
from kinegraph.devices.mqtt.fields import chosen
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Specs, StreamSpec, utc

REFRESH = 0.4
"""An unchanged state is repeated after this share of its `expire_after_s`."""


class EntityStates:
    """The last sent states of entities."""

    def __init__(self, entities: Mapping[str, Entity], specs: Specs) -> None:
        self._entities, self._specs = entities, specs
        self.sent: dict[str, tuple[str, float, int]] = {}
        """Per entity: the last sent state, when (monotonic s), and the sample's time."""
        self._newest: dict[str, int] = {}
        """Per stream, the newest sample's stamp."""

    def changed(self, port: str, chunk: Chunk) -> Iterator[tuple[str, str]]:
        """The entities, by name, with a state to send after a chunk of the stream `port`, and the state."""
        if len(chunk):
            self._newest[port] = int(chunk.time[-1])
        for name, entity in self._entities.items():
            if entity.of != port:
                continue
            before, when, stamp = self.sent.get(name, ("", 0.0, NEVER))
            text, at = self._state(entity, chunk, before, stamp)
            now = time.monotonic()
            stale = entity.expire_after_s > 0 and now - when >= REFRESH * entity.expire_after_s
            if text and (text != before or stale):
                self.sent[name] = (text, now, at)
                yield name, text

    def _state(self, entity: Entity, chunk: Chunk, before: str, last_ns: int) -> tuple[str, int]:
        """What is to be last_ns after a chunk, and of which sample; "": nothing is known yet."""
        if entity.alive_s:
            newest = self._newest.get(entity.of, NEVER)
            alive = newest != NEVER and chunk.until < FOREVER and chunk.until - newest <= entity.alive_s * NS
            return (ON if alive else OFF), newest
        spec = self._specs[entity.of]
        rows = chunk.data[chosen(chunk.data, entity.where)] if spec.is_event else chunk.data
        if not len(rows) or (not spec.is_event and last_ns != NEVER and chunk.time[-1] - last_ns < entity.every_s * NS):
            return before, last_ns
        row = rows[-1]
        value = row[entity.field or spec.channels[0]] if spec.is_event else row.reshape(-1)[_place(spec, entity.field)]
        return _text(value, entity), int(chunk.time[-1])


def _place(spec: StreamSpec, field: str) -> int:
    return spec.channels.index(field) if field else 0


def _text(value: Any, entity: Entity) -> str:
    """A value as Home Assistant takes it; what is not known is "None"."""
    if entity.device_class == "timestamp":
        return utc(int(value)) if value > 0 else UNKNOWN
    if entity.values is not None:
        return entity.values.get(str(value).lower() if isinstance(value, bool | np.bool_) else str(value), UNKNOWN)
    if isinstance(value, np.floating | float):
        return f"{value:.{entity.decimals}f}" if np.isfinite(value) else UNKNOWN
    return str(value)
