"""`kinegraph sleep setup` on the simulated bedroom: from an empty folder to a graph that would see the night."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from kinegraph.operators.bed.setup.guide import accepted
from kinegraph.stream.graph.reading.load import load
from tests.support.command_line import Command, refused
from tests.support.mosquitto import Mosquitto, broker, free_port

SHORT = ("--graph", "bedside_simulated", "--between", "80")
ROOM = "camera:\n    use: devices.people.bedside.Bedside\n    bed_h: 8"
SHORT_ROOM = "camera:\n    use: devices.people.bedside.Bedside\n    evening_min: 2\n    bed_h: 0.2"
HOME = """
  home:                             # what is published
    use: devices.mqtt.MqttOutlet
    from: {presence: bedside.presence}
    entities: {in_bed: {of: presence, field: state, name: In bed}}
"""


@pytest.fixture
def graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinegraph: Command) -> Path:
    """A graph of a bedroom in which somebody lies down after two minutes."""
    monkeypatch.chdir(tmp_path)
    assert kinegraph("configs", "bedside_simulated", "-o", ".")[0] == 0
    path = Path("bedside.yaml")
    text = Path("bedside_simulated.yaml").read_text()
    assert ROOM in text
    path.write_text(text.replace(ROOM, SHORT_ROOM) + HOME)
    return path


def answering(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_a_wrong_region_is_corrected_and_the_broker_tried(
    graph: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinegraph: Command
) -> None:
    graph.write_text(graph.read_text().replace("learn_s: 60}", "learn_s: 60, regions: [[0, 0, 24, 24]]}"))
    with broker(tmp_path) as mosquitto:
        answering(monkeypatch, "y", "y", "y", "y", "127.0.0.1", str(mosquitto.port), "-")
        code, out, err = kinegraph("sleep", "setup", *SHORT)
    assert code == 0, out + err
    assert "too small, or elsewhere" in out and "the region holds 100%" in out and "breath is seen" in out
    assert "accepts everybody" in out and "systemctl enable" in out
    text = graph.read_text()
    assert "regions: [[8, 56, 96, 40]]" in text and "# what is published" in text, "comments stay"
    home = load(graph).nodes["home"].part
    assert (home.broker.host, home.broker.port) == ("127.0.0.1", mosquitto.port)  # type: ignore[attr-defined]


def test_what_is_left_as_it_is_is_named_and_ends_with_2(
    graph: Path, monkeypatch: pytest.MonkeyPatch, kinegraph: Command
) -> None:
    answering(monkeypatch, "n", "-")
    refused(kinegraph("sleep", "setup", *SHORT), "would not be recorded properly")
    assert load(graph).nodes["home"].part.broker.host == ""  # type: ignore[attr-defined]


def test_a_user_whom_the_broker_refuses_is_named(tmp_path: Path) -> None:
    mosquitto = Mosquitto(tmp_path, password="right")
    mosquitto.start()
    try:
        assert "accepts me" in accepted("127.0.0.1", mosquitto.port, "me", "right")
        assert "refuses" in accepted("127.0.0.1", mosquitto.port, "me", "wrong")
    finally:
        mosquitto.stop()
    assert accepted("127.0.0.1", free_port(), "", "") == ""
