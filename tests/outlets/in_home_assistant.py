"""Home Assistant itself beside a broker: python in_home_assistant.py FOLDER PORT ENTITIES; prints what it has made of discovery as JSON.

Runs under a Python that has the packages homeassistant, janus, and paho-mqtt in the version that its MQTT integration asks for, and nothing
of this project. It ends when so many entities have a state, or after a minute.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import sys
from pathlib import Path

FOLDER, PORT, WANTED = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
ENTRY = {
    "entry_id": "broker", "version": 1, "minor_version": 1, "domain": "mqtt", "title": "broker", "options": {}, "source": "user",
    "data": {"broker": "127.0.0.1", "port": PORT, "discovery": True, "discovery_prefix": "homeassistant"}, "unique_id": None,
    "pref_disable_new_entities": False, "pref_disable_polling": False, "disabled_by": None,
}  # fmt: skip


def free_port() -> int:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        return int(door.getsockname()[1])


async def main() -> None:
    from homeassistant import auth, bootstrap, config_entries, core, loader
    from homeassistant.helpers import area_registry, device_registry, entity_registry
    from homeassistant.setup import async_setup_component

    stored = FOLDER / ".storage"
    stored.mkdir()
    (FOLDER / "configuration.yaml").touch()
    entries = {"version": 1, "minor_version": 1, "key": "core.config_entries", "data": {"entries": [ENTRY]}}
    (stored / "core.config_entries").write_text(json.dumps(entries))
    hass = core.HomeAssistant(str(FOLDER))
    hass.config.skip_pip = True
    loader.async_setup(hass)
    hass.config_entries = config_entries.ConfigEntries(hass, {})
    await bootstrap.async_load_base_functionality(hass)
    hass.auth = await auth.auth_manager_from_config(hass, [], [])
    assert await async_setup_component(hass, "homeassistant", {})
    assert await async_setup_component(hass, "mqtt", {"http": {"server_host": "127.0.0.1", "server_port": free_port()}})
    await hass.async_start()
    entities, devices, areas = (r.async_get(hass) for r in (entity_registry, device_registry, area_registry))
    for _ in range(600):
        found = [e for e in entities.entities.values() if e.platform == "mqtt"]
        known = [e for e in found if (s := hass.states.get(e.entity_id)) and s.state not in ("unknown", "unavailable")]
        if len(known) >= WANTED:
            break
        await asyncio.sleep(0.1)
    facts = {}
    for e in found:
        state = hass.states.get(e.entity_id)
        device = devices.async_get(e.device_id)
        area = areas.async_get_area(device.area_id) if device.area_id else None
        facts[e.entity_id] = {
            "state": state.state if state else None, "unique_id": e.unique_id, "category": e.entity_category,
            "attributes": dict(state.attributes) if state else {}, "device": device.name, "area": area.name if area else None,
        }  # fmt: skip
    print("FACTS " + json.dumps(facts, default=str), flush=True)
    await hass.async_stop(force=True)


logging.basicConfig(level=logging.WARNING)
asyncio.run(main())
