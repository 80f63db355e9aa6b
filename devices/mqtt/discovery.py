"""What Home Assistant learns of a device and its entities, so that they appear by themselves (MQTT discovery)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Literal

from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param

Component = Literal["sensor", "binary_sensor"]
BINARY_CLASSES = (
    "battery", "battery_charging", "carbon_monoxide", "cold", "connectivity", "door", "garage_door", "gas", "heat", "light", "lock",
    "moisture", "motion", "moving", "occupancy", "opening", "plug", "power", "presence", "problem", "running", "safety", "smoke", "sound",
    "tamper", "update", "vibration", "window",
)  # fmt: skip
"""The device classes that Home Assistant knows for a binary sensor."""
ON, OFF, UNKNOWN = "ON", "OFF", "None"
"""What a binary sensor's state may be; `None` means "unknown" to Home Assistant, for other sensors as well."""
_ID = re.compile(r"[a-zA-Z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Entity:
    """One entity in Home Assistant: a field of a stream's events, or a channel of a signal.

    of, field      the stream (one that the outlet reads) and the field or channel; left out: the first channel
    component      sensor, or binary_sensor
    where          only events whose fields have these values ({final: true})
    values         what a value becomes ({in: "ON", out: "OFF"}); one that is not named becomes unknown
    alive_s        in place of a field: ON while samples come, OFF after so long without samples
    every_s        a signal is reported at most this often
    decimals       of numbers
    expire_after_s after how long without news Home Assistant shows the entity as unavailable; unchanged states are repeated in time
    device_class   `timestamp`: the field is a time in ns, reported as ISO 8601
    name, unit, device_class, state_class, category (diagnostic), icon   as Home Assistant takes them
    """

    of: str
    name: str
    field: str = ""
    component: Component = "sensor"
    where: dict[str, str | float | bool] | None = None
    values: dict[str, str] | None = None
    alive_s: float = param(0.0, least=0.0)
    every_s: float = param(1.0, least=0.0)
    decimals: int = param(1, least=0, most=9)
    expire_after_s: int = param(120, least=0)
    unit: str = ""
    device_class: str = ""
    state_class: Literal["", "measurement", "total", "total_increasing"] = ""
    category: Literal["", "diagnostic"] = ""
    icon: str = ""

    def check(self, name: str) -> None:
        """Raises ParameterError for what Home Assistant would refuse."""
        where = f"entities.{name}"
        if not _ID.fullmatch(name):
            raise ParameterError(where, name, "a name of letters, digits, - and _")
        if self.component == "binary_sensor":
            if self.device_class and self.device_class not in BINARY_CLASSES:
                raise ParameterError(f"{where}.device_class", self.device_class, f"one of {', '.join(BINARY_CLASSES)}")
            if self.state_class or self.unit:
                raise ParameterError(f"{where}.unit", self.unit or self.state_class, "left out of a binary_sensor")
            if not self.alive_s and not (self.values and set(self.values.values()) <= {ON, OFF}):
                raise ParameterError(f"{where}.values", self.values, f"values that become {ON} or {OFF}")
        if self.device_class == "timestamp" and (self.unit or self.state_class or self.values):
            raise ParameterError(
                f"{where}.device_class", "timestamp", "a time alone, without unit, state_class or values"
            )
        if self.state_class and self.values:
            raise ParameterError(f"{where}.state_class", self.state_class, "left out where `values` are texts")
        if self.icon and not re.fullmatch(r"[a-z0-9]+:[a-z0-9-]+", self.icon):
            raise ParameterError(f"{where}.icon", self.icon, "an icon like mdi:bed")


@dataclass(frozen=True, slots=True)
class Device:
    """The device that all entities belong to. `id` must differ between devices: topics and unique ids begin with it."""

    id: str = "kinegraph"
    name: str = "kinegraph"
    model: str = ""
    area: str = ""

    def check(self) -> None:
        if not _ID.fullmatch(self.id):
            raise ParameterError("device", self.id, "an id of letters, digits, - and _")


@dataclass(frozen=True, slots=True)
class Topics:
    """Every topic of a device."""

    base: str
    device: str
    prefix: str

    def check(self) -> None:
        """Raises ParameterError where what all topics begin with is no topic, but a pattern or nothing."""
        for parameter, given in (("base", self.base), ("discovery", self.prefix)):
            wrong = any(sign in given for sign in "+#\0") or given.startswith("/") or given.endswith("/")
            if wrong or (not given and parameter == "base"):
                raise ParameterError(
                    parameter,
                    given,
                    "the beginning of a topic, without + and #, and without / at its ends",
                )

    def state(self, entity: str) -> str:
        return f"{self.base}/{self.device}/{entity}/state"

    def command(self, entity: str) -> str:
        return f"{self.base}/{self.device}/{entity}/set"

    def attributes(self, entity: str) -> str:
        return f"{self.base}/{self.device}/{entity}/attributes"

    def history(self, stream: str) -> str:
        return f"{self.base}/{self.device}/history/{stream.replace('.', '_')}"

    def mark(self) -> str:
        return f"{self.base}/{self.device}/mark"

    def availability(self, part: str = "") -> str:
        return f"{self.base}/{self.device}/{f'{part}/' if part else ''}availability"

    def config(self, component: str, entity: str) -> str:
        return f"{self.prefix}/{component}/{self.device}/{entity}/config"

    @property
    def birth(self) -> str:
        """Where Home Assistant says that it has started."""
        return f"{self.prefix}/status"


def announcement(name: str, entity: Entity, device: Device, topics: Topics) -> dict[str, Any]:
    """The discovery message of a sensor or binary sensor."""
    facts = {
        **shared(name, entity.name, device, topics.availability()),
        "state_topic": topics.state(name),
        "expire_after": entity.expire_after_s,
        "unit_of_measurement": entity.unit,
        "device_class": entity.device_class,
        "state_class": entity.state_class,
        "entity_category": entity.category,
        "icon": entity.icon,
    }
    if entity.component == "binary_sensor":
        facts |= {"payload_on": ON, "payload_off": OFF}
    elif entity.state_class:
        facts["suggested_display_precision"] = entity.decimals
    return {key: value for key, value in facts.items() if value not in ("", 0) or key == "suggested_display_precision"}


def switch(name: str, title: str, icon: str, device: Device, topics: Topics) -> dict[str, Any]:
    """The discovery message of a switch."""
    facts = {
        **shared(name, title, device, topics.availability(name)),
        "state_topic": topics.state(name),
        "command_topic": topics.command(name),
        "payload_on": ON,
        "payload_off": OFF,
        "icon": icon,
    }
    return {key: value for key, value in facts.items() if value != ""}


def shared(name: str, title: str, device: Device, availability: str) -> dict[str, Any]:
    """What every entity's discovery message holds."""
    ours = version("kinegraph")
    about = {
        "identifiers": [device.id],
        "name": device.name,
        "manufacturer": "kinegraph",
        "model": device.model,
        "sw_version": ours,
        "suggested_area": device.area,
    }
    return {
        "name": title,
        "unique_id": f"{device.id}_{name}",
        "availability_topic": availability,
        "payload_available": "online",
        "payload_not_available": "offline",
        "qos": 1,
        "device": {key: value for key, value in about.items() if value},
        "origin": {"name": "kinegraph", "sw_version": ours},
    }
