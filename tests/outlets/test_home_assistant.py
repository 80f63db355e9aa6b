"""What configs/bedside_sleep.yaml announces, taken by Home Assistant itself over a real broker; and the dashboard of the docs.

KINEGRAPH_HASS names a Python with homeassistant (`python3.11 -m venv hass && hass/bin/pip install homeassistant==2024.3.3 paho-mqtt==1.6.1
janus==1.0.0`); without it the messages are held against the documented schemas alone (tests/sleep/test_bedside_night.py).
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from kinegraph.devices.mqtt import MqttOutlet
from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.graph.reading.load import load
from tests.sleep.test_nights_weeks import logged
from tests.support import home_assistant
from tests.support.mosquitto import broker, listening

HERE = Path(__file__).parent
CONFIG = HERE.parents[1] / "configs" / "bedside_sleep.yaml"
DOCS = HERE.parents[1] / "docs" / "use" / "bedside.md"
NOW = 1_767_225_600 * NS


def outlet(port: int, nights: Path) -> MqttOutlet:
    """The shipped graph's own outlet, at another broker."""
    facts = {
        "home.broker": {"host": "127.0.0.1", "port": port},
        "home.ledger": "",
        "home.report": {"nights": str(nights)},
    }
    graph = load(CONFIG, overrides=facts)
    made = graph.nodes["home"].part.unopened()
    assert isinstance(made, MqttOutlet)
    made.open(graph.input_specs(graph.nodes["home"]))
    return made


def rows(made: MqttOutlet) -> None:
    """One sample of every stream, with values that are known."""
    given = {
        "state": {"presence": "in", "scorer": "sleep"},
        "what": {"view": "steady"},
        "why": {"activity.epochs": "light"},
    }
    for stream, spec in made.runtime.specs.items():
        if spec.is_event:
            row = np.zeros(1, spec.dtype)
            for field in spec.channels:
                row[field] = given.get(field, {}).get(stream, 0 if spec.dtype[field].kind == "U" else 7)
            for field in {"onset", "end"} & {*spec.channels}:
                row[field] = NOW
            if "final" in spec.channels:
                for final in (False, True):
                    row["final"] = final
                    made.process(stream, Chunk(np.array([NOW]), row.copy(), NOW))
                continue
        else:
            row = np.ones((1, *spec.shape), spec.dtype)
        made.process(stream, Chunk(np.array([NOW]), row, NOW))


def cards(card: dict[str, Any]) -> set[str]:
    """Every entity that a card shows."""
    named = {e for e in card.get("entities", ()) if isinstance(e, str)} | set(
        re.findall(r"'(\w+\.\w+)'", card.get("content", ""))
    )
    return named.union(*(cards(inner) for inner in card.get("cards", ())))


def test_home_assistant_makes_of_it_what_the_docs_say(tmp_path: Path) -> None:
    python = os.environ.get("KINEGRAPH_HASS", "")
    if not python:
        pytest.skip("KINEGRAPH_HASS names no Python with homeassistant")
    (logged(tmp_path / "nights", "2026-11-02T23:05", "s" * 14) / "report.html").write_text("drawn")
    folder = tmp_path / "hass"
    folder.mkdir()
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        made = outlet(mosquitto.port, tmp_path / "nights")
        made.begin()
        try:
            rows(made)
            client.wait_for("kinegraph/bed/report/state")
            command = [python, str(HERE / "in_home_assistant.py"), str(folder), str(mosquitto.port), "15"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=tmp_path)
        finally:
            made.close()
        topics = {topic: json.loads(text) for topic, text, _ in client.messages if topic.endswith("/config")}
    for topic, message in topics.items():
        home_assistant.check(topic, message)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("FACTS ")] or pytest.fail(
        done.stderr[-3000:]
    )
    record = json.loads(line.removeprefix("FACTS "))
    assert {e["unique_id"] for e in record.values()} == {m["unique_id"] for m in topics.values()}, done.stderr[-2000:]
    assert {(e["device"], e["area"]) for e in record.values()} == {("Bed", "Bedroom")}
    assert {e["state"] for e in record.values()} & {"unknown", "unavailable", None} == set(), record
    assert record["binary_sensor.bed_in_bed"]["state"] == "on"
    assert record["sensor.bed_night_in_bed_from"]["state"] == "2026-01-01T00:00:00+00:00"
    report = record["sensor.bed_report"]
    assert report["state"].startswith("Asleep ") and report["attributes"]["address"].endswith("/report.html")
    assert {name for name, e in record.items() if e["category"] == "diagnostic"} >= {
        "sensor.bed_frames_seen", "binary_sensor.bed_camera_was_moved", "sensor.bed_night_not_known",
    }  # fmt: skip
    text = re.search(r"```yaml dashboard.yaml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    assert text and cards(YAML(typ="safe").load(text[1])) <= set(record)
