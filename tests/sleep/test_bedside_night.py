"""A night from frames to the morning, by configs/bedside_sleep.yaml: two power cuts, a camera that goes, a clock set back; and in the end
the report agrees with home automation, epoch by epoch. KINEGRAPH_NIGHT_H=8 makes it a night of eight hours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from kinegraph.devices.reports.night import archive
from kinegraph.stream.chunk import NS, utc
from kinegraph.stream.graph.reading.load import read_expanded
from tests.support import home_assistant
from tests.support.mosquitto import Listener, broker, listening

pytestmark = pytest.mark.nightly

HERE = Path(__file__).parent
CONFIG = HERE.parents[1] / "configs" / "bedside_sleep.yaml"
HISTORY = "kinegraph/bed/history/scorer"
BED_H = float(os.environ.get("KINEGRAPH_NIGHT_H", "1.3"))
"""How long the night is; 8 takes about a minute."""
GONE_S = (3000, 600)
"""When the camera goes, and for how long."""


def night(folder: Path, port: int, **camera: Any) -> Path:
    """The configuration with a simulated bedroom in the camera's place, as fast as it goes, without switches."""
    graph: Any = read_expanded(CONFIG).plain()
    nodes = graph["nodes"]
    for name in ("pause_switch", "lights", "seen"):
        del nodes[name]
    now = datetime.now(UTC)
    nodes["camera"] = {
        "use": "devices.people.bedside.Bedside", "bed_h": BED_H, "fps": 1 if BED_H < 2 else 2, "evening_min": 4, "morning_min": 4,
        "exits": 1, "seed": 3, "evening": f"{now:%H:%M}", "faults": [["gone", *GONE_S]], **camera,
    }  # fmt: skip
    nodes["bedside.simplify"] |= {"from": "camera.depth", "learn_s": 60}
    nodes["night.nights"]["from"] = {"bed": "bedside.presence"}
    nodes["night.log"]["from"].pop("lights")
    nodes["night.log"] |= {"path": str(folder / "nights"), "timezone": "Europe/Berlin"}
    nodes["home"] |= {"broker": {"host": "127.0.0.1", "port": port}, "ledger": str(folder / "sent.json")}
    nodes["home"]["history"][0]["log"] = str(folder / "nights")
    nodes["home"]["report"]["nights"] = str(folder / "nights")
    graph["checkpoint_s"] = 0.1  # at this pace minutes of the night
    graph["recording"] |= {"rotate_mb": 0.02, "flush_s": 0.2}
    path = folder / "bedside.yaml"
    with path.open("w") as file:
        YAML().dump(graph, file)
    return path


def start(config: Path, folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, str(HERE / "bedside_process.py"), str(config), str(folder), *options]
    with (config.parent / "log.txt").open("a") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
    assert process.stdout and process.stdout.readline() == "going\n"
    return process


def over(process: subprocess.Popen[str], *, killed: bool = False) -> int:
    if killed:
        process.kill()
    code = process.wait(240)
    assert process.stdout
    process.stdout.close()
    return code


def history(client: Listener) -> list[tuple[int, str]]:
    """(onset, state) of every final epoch that was reported, as it came; what a new listener is sent again first is left out."""
    epochs_sent = [json.loads(text) for topic, text, retained in client.messages if topic == HISTORY and not retained]
    return [(epoch["key"], epoch["state"]) for epoch in epochs_sent]


@pytest.mark.timeout(600)
def test_a_night_with_two_power_cuts_ends_in_a_report_that_agrees_with_what_was_told(tmp_path: Path) -> None:
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        config, session = night(tmp_path, mosquitto.port), tmp_path / "session"
        process = start(config, session)
        client.wait(lambda: len(history(client)) >= 40)
        over(process, killed=True)
        first = len(history(client))
        client.wait_for("kinegraph/bed/availability", "offline")  # the last will
        process = start(config, session, "--resume")
        client.wait(lambda: len(history(client)) >= first + 5)
        (tmp_path / "set-back").touch()  # daylight saving ends
        client.wait(lambda: len(history(client)) >= max(80, first + 15))
        over(process, killed=True)
        process = start(config, session, "--resume")
        assert over(process) == 0, (tmp_path / "log.txt").read_text()[-3000:]
        epochs_sent = history(client)
        entities = {t: json.loads(x) for t, x, _ in client.messages if t.startswith("homeassistant/")}
        topics = {topic: text for topic, text, _ in client.messages}

    onsets = [onset for onset, _ in epochs_sent]
    assert onsets == sorted(set(onsets)), "an epoch was reported twice, or out of turn"
    ((folder, facts),) = archive.nights(tmp_path / "nights")
    epochs = archive.read_epochs(folder)
    logged = list(zip(epochs.onset.tolist(), epochs.texts["state"].tolist(), strict=True))
    assert len(logged) > 130
    assert [(onset, state) for onset, state in epochs_sent if logged[0][0] <= onset <= logged[-1][0]] == logged
    assert topics["kinegraph/bed/asleep_final/state"] in ("ON", "OFF", "None")

    for topic, message in entities.items():
        home_assistant.check(topic, message)
    assert len(entities) == 15
    assert {message["device"]["suggested_area"] for message in entities.values()} == {"Bedroom"}
    assert topics["kinegraph/bed/report/state"].startswith("Asleep ")
    assert json.loads(topics["kinegraph/bed/report/attributes"])["address"] == (folder / "report.html").as_uri()
    reported = {name: topics[f"kinegraph/bed/{name}/state"] for name in ("night_asleep", "night_from", "night_to")}
    assert abs(float(reported["night_asleep"]) - facts.numbers["tst"]) <= 3, "the log has epochs from before the cuts"
    assert reported["night_from"] == utc(int(facts.numbers["onset"]))

    assert facts.closed and facts.numbers["tib"] > 60 and len(facts.breaks) == 2
    assert {"sleep", "wake"} <= set(epochs.texts["state"])
    step = 30 * NS
    spaces = {b - a for a, b in zip(epochs.onset.tolist(), epochs.onset.tolist()[1:], strict=False)}
    assert spaces == {step}, "an epoch is missing: what was not seen must be unknown"
    longest = max(
        (len(run) for run in "".join("u" if s == "unknown" else "." for _, s in logged).split(".")), default=0
    )
    assert 17 <= longest <= 24, "ten minutes without a camera"
    page = (folder / "report.html").read_text()
    assert "kinegraph did not run" in page and "Not scored" in page and "simulated" in page
    assert {path.name for path in folder.iterdir()} >= {*archive.DRAWN, archive.MAP}
    assert archive.bytes_of(folder) < 1_000_000 and not list(session.glob("*.mcap"))
    assert "compiled while running" not in (tmp_path / "log.txt").read_text()
