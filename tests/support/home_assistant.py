"""Home Assistant's documented fields of MQTT discovery messages, as JSON Schemas: what is not documented there is refused.

From the pages "MQTT sensor", "MQTT binary sensor", "MQTT switch" and "MQTT" (discovery, device, origin) of its documentation.
"""

from __future__ import annotations

from typing import Any

TEXT, FLAG = {"type": "string", "minLength": 1}, {"type": "boolean"}
TOPIC = {"type": "string", "pattern": r"^[^#+\u0000]+$"}
SECONDS = {"type": "integer", "minimum": 0}
DEVICE = {
    "type": "object",
    "additionalProperties": False,
    "properties": {
        "configuration_url": TEXT,
        "connections": {"type": "array", "items": {"type": "array", "items": TEXT, "minItems": 2, "maxItems": 2}},
        "identifiers": {"type": "array", "items": TEXT, "minItems": 1},
        **dict.fromkeys(
            ("hw_version", "manufacturer", "model", "model_id", "name", "serial_number", "suggested_area"), TEXT
        ),
        **dict.fromkeys(("sw_version", "via_device"), TEXT),
    },
    "anyOf": [{"required": ["identifiers"]}, {"required": ["connections"]}],
}
ORIGIN = {
    "type": "object",
    "additionalProperties": False,
    "properties": {"name": TEXT, "sw_version": TEXT, "support_url": TEXT},
    "required": ["name"],
}
SHARED: dict[str, Any] = {
    "availability_topic": TOPIC,
    "availability_mode": {"enum": ["all", "any", "latest"]},
    "availability_template": TEXT,
    "default_entity_id": TEXT,
    "device": DEVICE,
    "origin": ORIGIN,
    "enabled_by_default": FLAG,
    "encoding": {"type": "string"},
    "entity_category": {"const": "diagnostic"},
    "entity_picture": TEXT,
    "icon": {"type": "string", "pattern": "^[a-z0-9]+:[a-z0-9-]+$"},
    "json_attributes_template": TEXT,
    "json_attributes_topic": TOPIC,
    "name": TEXT,
    "payload_available": TEXT,
    "payload_not_available": TEXT,
    "qos": {"enum": [0, 1, 2]},
    "state_topic": TOPIC,
    "unique_id": TEXT,
    "value_template": TEXT,
}
STATE = {"expire_after": SECONDS, "force_update": FLAG}
BINARY_CLASSES = [
    "battery",
    "battery_charging",
    "carbon_monoxide",
    "cold",
    "connectivity",
    "door",
    "garage_door",
    "gas",
    "heat",
    "light",
    "lock",
    "moisture",
    "motion",
    "moving",
    "occupancy",
    "opening",
    "plug",
    "power",
    "presence",
    "problem",
    "running",
    "safety",
    "smoke",
    "sound",
    "tamper",
    "update",
    "vibration",
    "window",
]
SENSOR_CLASSES = [
    "absolute_humidity",
    "apparent_power",
    "aqi",
    "area",
    "atmospheric_pressure",
    "battery",
    "blood_glucose_concentration",
    "carbon_dioxide",
    "carbon_monoxide",
    "current",
    "data_rate",
    "data_size",
    "date",
    "distance",
    "duration",
    "energy",
    "energy_distance",
    "energy_storage",
    "enum",
    "frequency",
    "gas",
    "humidity",
    "illuminance",
    "irradiance",
    "moisture",
    "monetary",
    "nitrogen_dioxide",
    "nitrogen_monoxide",
    "nitrous_oxide",
    "ozone",
    "ph",
    "pm1",
    "pm25",
    "pm10",
    "power_factor",
    "power",
    "precipitation",
    "precipitation_intensity",
    "pressure",
    "reactive_energy",
    "reactive_power",
    "signal_strength",
    "sound_pressure",
    "speed",
    "sulphur_dioxide",
    "temperature",
    "timestamp",
    "volatile_organic_compounds",
    "volatile_organic_compounds_parts",
    "voltage",
    "volume",
    "volume_flow_rate",
    "volume_storage",
    "water",
    "weight",
    "wind_direction",
    "wind_speed",
]


def _schema(needed: tuple[str, ...], **fields: Any) -> dict[str, Any]:
    # a device only works with a unique id; discovery wants an origin where a device is given
    linked = {"device": ["unique_id"], "availability_mode": ["availability"]}
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": {**SHARED, **fields},
        "required": [*needed, "unique_id", "device", "availability_topic", "origin", "name"],
        "dependentRequired": linked,
    }


SCHEMAS = {
    "binary_sensor": _schema(
        ("state_topic",),
        **STATE,
        device_class={"enum": BINARY_CLASSES},
        off_delay=SECONDS,
        payload_on=TEXT,
        payload_off=TEXT,
    ),
    "sensor": _schema(
        ("state_topic",),
        **STATE,
        device_class={"enum": SENSOR_CLASSES},
        state_class={"enum": ["measurement", "measurement_angle", "total", "total_increasing"]},
        unit_of_measurement=TEXT,
        suggested_display_precision={"type": "integer", "minimum": 0},
        last_reset_value_template=TEXT,
        options={"type": "array", "items": TEXT, "minItems": 1},
    ),
    "switch": _schema(
        ("command_topic",),
        device_class={"enum": ["outlet", "switch"]},
        command_topic=TOPIC,
        command_template=TEXT,
        optimistic=FLAG,
        payload_on=TEXT,
        payload_off=TEXT,
        retain=FLAG,
        state_on=TEXT,
        state_off=TEXT,
    ),
}


def check(topic: str, facts: dict[str, Any]) -> None:
    """A discovery message is as Home Assistant documents it; raises jsonschema.ValidationError or AssertionError."""
    from jsonschema import validate

    prefix, component, node, name, last = topic.split("/")
    assert (prefix, last) == ("homeassistant", "config")
    assert all(part.replace("_", "").replace("-", "").isalnum() for part in (node, name))
    validate(facts, SCHEMAS[component])
    if "state_class" in facts:
        assert facts.get("device_class") not in ("date", "enum", "timestamp")
