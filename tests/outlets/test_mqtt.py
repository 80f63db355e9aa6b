"""MQTT against a real Mosquitto broker: entities, discovery, availability, histories that arrive once, the switch."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paho.mqtt.client import MQTTMessage
from structlog.testing import capture_logs

from kinegraph.devices.mqtt import MqttOutlet, MqttSwitch
from kinegraph.devices.mqtt.discovery import Device, Entity
from kinegraph.devices.mqtt.link import FIRST_PAUSE_S, Broker
from kinegraph.devices.mqtt.message_queue import MAX_MESSAGES, MessageQueue, MessageQueueState
from kinegraph.devices.mqtt.sent_events import SentEvents
from kinegraph.stream.chunk import FOREVER, NS, Chunk, StreamSpec, empty, utc
from kinegraph.stream.engine.pipeline import Pipeline, Stage
from kinegraph.stream.errors import KinegraphError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support import home_assistant
from tests.support.command_line import KINEGRAPH, Command
from tests.support.device_feed import check, reading
from tests.support.mosquitto import Listener, Mosquitto, broker, eventually, free_port, listening

START = 1_767_000_000 * NS
EPOCH = np.dtype([("onset", "<i8"), ("state", "U7"), ("final", "?"), ("score", "<f8")])
SPECS = {
    "scorer": StreamSpec((), EPOCH, units=("ns", "", "", "")),
    "motion": StreamSpec((2,), rate_hz=30.0, channels=("left", "right"), units=("mm",)),
}
ENTITIES = {
    "asleep": Entity("scorer", "Asleep", "state", "binary_sensor", {"final": True}, {"sleep": "ON", "wake": "OFF"}),
    "movement": Entity("motion", "Movement", "right", unit="mm", state_class="measurement", decimals=2, icon="mdi:run"),
    "camera": Entity("motion", "Camera", component="binary_sensor", alive_s=5, device_class="connectivity"),
}
PREFIX = "kinegraph/bed"


def outlet(port: int | Broker, ledger: Path | None = None, **more: Any) -> MqttOutlet:
    given = {"entities": ENTITIES, "device": Device("bed", "Bed", "simulated", "Bedroom"), **more}
    made = MqttOutlet(
        broker=Broker("127.0.0.1", port) if isinstance(port, int) else port,
        history=(SentEvents("scorer", {"final": True}),),
        ledger=str(ledger or ""),
        **given,
    )
    made.open(SPECS)
    return made


@contextmanager
def running(made: MqttOutlet) -> Iterator[MqttOutlet]:
    made.begin()
    try:
        yield made
    finally:
        made.close()


def epochs(*numbers: int, final: bool = True, state: str = "sleep") -> Chunk:
    stamps = START + np.array(numbers) * 30 * NS
    return Chunk(stamps, np.array([(t, state, final, 0.5) for t in stamps.tolist()], EPOCH), int(stamps[-1]))


def counts(client: Listener) -> list[int]:
    """The numbers of the epochs in the history, as they came."""
    return [(json.loads(text)["key"] - START) // (30 * NS) for text in client.texts(f"{PREFIX}/history/scorer")]


def vanish(made: MqttOutlet) -> None:
    """As a killed process does: the socket closes, without a good-bye."""
    link = made.runtime.link
    assert link and link._client
    link._stopping.set()
    sock = link._client.socket()
    assert sock
    sock.shutdown(2)
    link._thread.join(10)
    made.runtime.link = None


def test_states_discovery_and_availability(tmp_path: Path) -> None:
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        with running(outlet(mosquitto.port)) as made:
            assert client.wait_for(f"{PREFIX}/availability") == "online"
            for name, entity in ENTITIES.items():
                topic = f"homeassistant/{entity.component}/bed/{name}/config"
                home_assistant.check(topic, json.loads(client.wait_for(topic)))
            made.process("scorer", epochs(0, final=False))
            made.process("scorer", epochs(1))
            made.process("motion", Chunk(np.array([START]), np.array([[1.0, 2.0]]), START))
            assert client.wait_for(f"{PREFIX}/asleep/state") == "ON"
            assert client.wait_for(f"{PREFIX}/movement/state") == "2.00"
            assert client.wait_for(f"{PREFIX}/camera/state") == "ON"
            made.process("scorer", epochs(2, state="unknown"))
            made.process("motion", Chunk(np.array([START + NS]), np.array([[1.0, np.nan]]), START + NS))
            made.process("motion", empty(SPECS["motion"], START + 7 * NS))
            client.wait_for(f"{PREFIX}/asleep/state", "None")
            client.wait_for(f"{PREFIX}/movement/state", "None")
            client.wait_for(f"{PREFIX}/camera/state", "OFF")
            first = json.loads(client.wait_for(f"{PREFIX}/history/scorer"))
            assert {k: first[k] for k in ("onset", "state", "final", "score")} == {
                "onset": utc(START + 30 * NS), "state": "sleep", "final": True, "score": 0.5,
            } or counts(client) == [1, 2]  # fmt: skip
        client.wait_for(f"{PREFIX}/availability", "offline")
    assert counts(client) == [1, 2]


def test_what_is_told_is_retained_and_told_again_when_home_assistant_starts(tmp_path: Path) -> None:
    config = "homeassistant/binary_sensor/bed/asleep/config"
    with broker(tmp_path) as mosquitto, running(outlet(mosquitto.port)) as made:
        made.process("scorer", epochs(1))
        with listening(mosquitto.port) as late:
            late.wait_for(config)
            late.wait_for(f"{PREFIX}/asleep/state", "ON")
            late.say("homeassistant/status", "online")
            late.wait(lambda: sum(topic == config for topic, *_ in late.messages) >= 2)
            late.wait(lambda: sum(topic == f"{PREFIX}/asleep/state" for topic, *_ in late.messages) >= 2)
        assert len(counts(late)) <= 1  # the history is not sent again


def test_the_broker_says_when_we_vanish(tmp_path: Path) -> None:
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        made = outlet(mosquitto.port)
        made.begin()
        client.wait_for(f"{PREFIX}/availability", "online")
        vanish(made)
        client.wait_for(f"{PREFIX}/availability", "offline")


def test_a_broker_that_is_down_at_start_and_goes_and_comes_back(tmp_path: Path) -> None:
    mosquitto = Mosquitto(tmp_path, free_port())
    with running(outlet(mosquitto.port)) as made:
        made.process("scorer", epochs(0, 1, 2))
        mosquitto.start()
        try:
            with listening(mosquitto.port) as client:
                client.wait(lambda: counts(client)[-1:] == [2])
                first = counts(client)
                made.process("scorer", epochs(3))
                client.wait(lambda: counts(client)[-1:] == [3])
            mosquitto.stop()
            made.process("scorer", epochs(4, 5, state="wake"))
            mosquitto.start()
            with listening(mosquitto.port) as client:
                client.wait(lambda: counts(client)[-1:] == [5])
                second = counts(client)
                client.wait_for(f"{PREFIX}/asleep/state", "OFF")
                client.wait_for(f"{PREFIX}/availability", "online")
        finally:
            mosquitto.stop()
    assert first in (
        [0, 1, 2],
        [1, 2],
        [2],
    )  # this client may have come later than the outlet; the last one is retained
    assert [n for n in second if n > 3] == [4, 5] or second == [5]


@pytest.mark.parametrize("ledger", [True, False], ids=["a ledger", "the broker's memory"])
def test_nothing_is_sent_twice_after_a_killed_process(tmp_path: Path, ledger: bool) -> None:
    """The checkpoint is older than what was sent; what came after it is worked through again."""
    path = tmp_path / "sent.json" if ledger else None
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        made = outlet(mosquitto.port, path)
        made.begin()
        made.process("scorer", epochs(0, 1))
        client.wait(lambda: counts(client) == [0, 1])
        checkpoint = made.snapshot()
        made.process("scorer", epochs(2, 3, 4))
        client.wait(lambda: counts(client) == [0, 1, 2, 3, 4])
        vanish(made)
        again = outlet(mosquitto.port, path)
        again.restore(checkpoint)
        with running(again):
            again.process("scorer", epochs(2, 3, 4, 5))
            client.wait(lambda: counts(client)[-1:] == [5])
    assert counts(client) == [0, 1, 2, 3, 4, 5]


def test_a_new_session_owes_nothing_to_the_former_ones(tmp_path: Path) -> None:
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        for _ in range(2):
            with running(outlet(mosquitto.port, tmp_path / "sent.json")) as made:
                made.process("scorer", epochs(0, 1))
                eventually(lambda made=made: bool(made.runtime.messages and made.runtime.messages.empty))
        client.wait(lambda: counts(client) == [0, 1, 0, 1])


def test_a_message_queue_is_bounded_and_survives_in_a_checkpoint() -> None:
    rows: list[str] = []
    messages = MessageQueue(MessageQueueState("s"), lambda topic, text, retain: None)
    for key in range(MAX_MESSAGES + 10):
        messages.post("t", key, f"message {key}")
    assert messages.dropped == 10
    again = MessageQueue(messages.keep(), lambda topic, text, retain: rows.append(text) or len(rows))
    again.open()
    assert rows[0] == "message 10" and len(rows) == 16  # at most so many are under way
    again.delivered(1)
    assert len(rows) == 17
    again.remembered("t", json.dumps({"session": "s", "key": MAX_MESSAGES}))
    assert rows[-1] != f"message {MAX_MESSAGES}" and json.loads(again.keep().arrived) == {"t": MAX_MESSAGES}
    again.remembered("t", json.dumps({"session": "another", "key": MAX_MESSAGES + 9}))
    assert json.loads(again.keep().arrived) == {"t": MAX_MESSAGES}


def test_a_switch_is_switched_and_remembers(tmp_path: Path) -> None:
    def switch(port: int) -> MqttSwitch:
        return MqttSwitch("lights", "Lights", initial=True, broker=Broker("127.0.0.1", port), device=Device("bed"))

    state, command, config = f"{PREFIX}/lights/state", f"{PREFIX}/lights/set", "homeassistant/switch/bed/lights/config"
    with broker(tmp_path) as mosquitto, listening(mosquitto.port) as client:
        client.say(command, "OFF", retain=True)  # an old command is ignored
        source = switch(mosquitto.port)
        with reading(source) as feed:
            home_assistant.check(config, json.loads(client.wait_for(config)))
            client.wait_for(f"{PREFIX}/lights/availability", "online")
            client.say(command, "ON")
            client.wait_for(state, "ON")
            client.say(command, "off")
            client.wait_for(state, "OFF")
            client.say("homeassistant/status", "online")
            client.wait(lambda: client.texts(state) == ["ON", "OFF", "OFF"])
            eventually(lambda: feed.count("out") == 1)
        check(source, feed)
        assert feed.data("out")["on"].tolist() == [False] and feed.error is None
        client.wait_for(f"{PREFIX}/lights/availability", "offline")
        with reading(switch(mosquitto.port)) as feed:
            eventually(lambda: feed.count("out") == 1)
        assert feed.data("out")["on"].tolist() == [False]


def test_a_switch_without_a_broker_lets_time_pass() -> None:
    source = MqttSwitch("pause", broker=Broker("127.0.0.1", free_port()))
    with reading(source) as feed:
        eventually(lambda: len(feed.chunks.get("out", ())) > 2)
    assert feed.error is None and feed.count("out") == 0
    assert all(a.until < b.until for a, b in zip(feed.chunks["out"], feed.chunks["out"][1:], strict=False))


@pytest.mark.parametrize(
    ("more", "word"),
    [
        ({"entities": {"a b": ENTITIES["asleep"]}}, "letters"),
        ({"entities": {"x": Entity("scorers", "X")}}, "scorer"),
        ({"entities": {"x": Entity("scorer", "X", "stat")}}, "state"),
        ({"entities": {"x": Entity("scorer", "X", "state", where={"finale": True})}}, "final"),
        ({"entities": {"x": Entity("scorer", "X", "state", "binary_sensor")}}, "ON"),
        ({"entities": {"x": Entity("motion", "X", component="binary_sensor", alive_s=1, device_class="bed")}}, "occupancy"),
        ({"device": Device("my bed")}, "letters"),
        ({"base": "home/#"}, "topic"),
        ({"base": ""}, "topic"),
        ({"discovery": "/ha"}, "topic"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_anything_starts(more: dict[str, Any], word: str) -> None:
    with pytest.raises(ParameterError, match=word):
        outlet(1, **more)


def test_a_password_stands_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("secret\n")
    assert Broker(username="me", password_file=str(file)).password == "secret"
    with pytest.raises(KinegraphError, match="username"):
        Broker(password_file=str(file)).check()
    with pytest.raises(KinegraphError, match="exists"):
        Broker(username="me", password_file=str(tmp_path / "none")).check()


@pytest.mark.parametrize(
    "broker",
    [
        "{host: 127.0.0.1, password: hunter2}",
        "{host: 'me:hunter2@127.0.0.1'}",
        "{host: 'mqtt://me:hunter2@127.0.0.1'}",
        "{host: 127.0.0.1, username: me, password_file: hunter2}",
        "{host: 127.0.0.1, username: me, passwd: hunter2, password_file: ''}",
    ],
)
def test_a_password_in_a_wrong_place_is_refused_and_not_repeated(
    broker: str, kinegraph: Command, tmp_path: Path
) -> None:
    board = "nodes:\n  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 1}\n"
    entities = "device: {id: x}, entities: {a: {of: board.emg, name: A}}"
    home = f"  home: {{use: devices.mqtt.MqttOutlet, from: board.emg, broker: {broker}, {entities}}}\n"
    (tmp_path / "g.yaml").write_text(board + home)
    for command in (("check",), ("run", "--view", "none", "-o", "s")):
        code, out, output = kinegraph(command[0], "g.yaml", *command[1:])
        assert code == 2 and "broker." in output and "hunter2" not in out + output, output
    assert not (tmp_path / "s").exists()


def test_a_broker_that_refuses_the_password_is_tried_ever_less_often_and_told_of_once(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("wrong\n")
    mosquitto = Mosquitto(tmp_path, password="secret").start()
    try:
        with capture_logs() as logs, running(outlet(Broker("127.0.0.1", mosquitto.port, "me", str(file)))) as made:
            link = made.runtime.link
            assert link
            eventually(lambda: link.failures >= 3)
            assert link.pause_s > FIRST_PAUSE_S
            file.unlink()
            link.hasten()
            eventually(lambda: any("No such file" in line.get("why", "") for line in logs))
            file.write_text("secret\n")
            link.hasten()
            eventually(lambda: link.there)
    finally:
        mosquitto.stop()
    complaints = [line for line in logs if line["log_level"] == "warning"]
    assert len(complaints) == 2 and "'me'" in complaints[0]["why"] and "password_file" in complaints[0]["why"]


def test_what_waits_at_the_end_is_sent_if_the_broker_is_back(tmp_path: Path) -> None:
    mosquitto = Mosquitto(tmp_path, free_port())
    made = outlet(mosquitto.port)
    made.begin()
    link = made.runtime.link
    assert link
    made.process("scorer", epochs(*range(100)))
    eventually(lambda: link.failures > 0)
    link.pause_s = 1e6  # nothing but the end itself makes it try again
    eventually(lambda: link.failures > 1)
    mosquitto.start()
    try:
        with capture_logs() as logs:
            made.close()
        with listening(mosquitto.port) as late:
            late.wait_for(f"{PREFIX}/history/scorer")
            assert counts(late) == [99]  # the retained one
    finally:
        mosquitto.stop()
    assert not [line for line in logs if line["log_level"] == "warning"]


def test_how_many_events_a_broker_never_got_is_told_at_the_end(tmp_path: Path) -> None:
    made = outlet(free_port())
    with running(made):
        made.process("scorer", epochs(0, 1, 2))
    assert "did not get 3 events of the history" in made.undelivered


def test_the_end_of_a_stream_is_no_life(tmp_path: Path) -> None:
    made = outlet(free_port())
    with running(made):
        made.process("motion", Chunk(np.array([START]), np.array([[1.0, 2.0]]), FOREVER))
        assert made.runtime.states.sent["camera"][0] == "OFF"


def test_home_closes_after_the_log_whatever_the_order_so_that_a_report_drawn_at_the_end_is_announced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graph = load_text("""
nodes:
  walk: {use: devices.people.treadmill.Treadmill}
  home:
    use: devices.mqtt.MqttOutlet
    from: {force: walk.force}
    broker: {host: ""}
    entities: {force: {of: force, field: Fz, name: Force}}
  log: {use: devices.outlets.csv_file.CsvFile, from: walk.force, path: force.csv}
""")
    closed: list[str] = []
    monkeypatch.setattr(Stage, "close", lambda stage: closed.append(stage.node.name))
    Pipeline(graph, speaking=["home", "log"]).close()
    assert closed == ["log", "home"]


def test_a_broker_that_never_answers_holds_nobody_up() -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as silent:
        made = outlet(silent.getsockname()[1])
        with running(made):
            for k in range(500):
                made.process("scorer", epochs(k))
            assert made.runtime.messages and not made.runtime.messages.empty
            assert len(json.loads("[" + ",".join(MessageQueueState(**_texts(made)).messages.splitlines()) + "]")) == 500


def _texts(made: MqttOutlet) -> dict[str, str]:
    return {name: str(array) for name, array in made.snapshot().items()}


def test_a_long_message_costs_no_memory_and_the_next_one_arrives(tmp_path: Path) -> None:
    """256 MB may come in one message: nothing of it is kept, it is confirmed, and the connection stands."""
    from kinegraph.devices.mqtt.link import Broker, BrokerConnection

    heard: list[str] = []
    with broker(tmp_path) as served, listening(served.port) as listener:
        ready = threading.Event()
        link = BrokerConnection(
            *(Broker(port=served.port), "bounded", "x/availability", ["x/set"]),
            joined=ready.set,
            heard=lambda topic, text, retained: heard.append(text),
        )
        link.start()
        assert ready.wait(60)
        try:
            listener.client.unsubscribe("#")
            for _ in range(25):  # more than a broker sends before some are confirmed
                listener.client.publish("x/set", bytes(4 << 20), qos=1).wait_for_publish(60)
            listener.client.publish("x/set", "ON", qos=1).wait_for_publish(60)
            eventually(lambda: heard == ["ON"])
            assert link._client is not None and link._client.dropped == 25
        finally:
            link.stop()


def test_messages_that_come_too_fast_are_counted_and_dropped() -> None:
    from kinegraph.devices.mqtt.link import MAX_NEWS, Broker, BrokerConnection

    link = BrokerConnection(Broker(), "flood", "x/availability", ["x/set"], joined=lambda: None)
    for _ in range(MAX_NEWS + 7):
        link._take(MQTTMessage(topic=b"x/set"))
    assert link.dropped == 7


def test_a_password_stands_nowhere_but_in_its_file(tmp_path: Path) -> None:
    """Not in the recording (which holds the graph), the log, the errors, or what other users see of the process."""
    secret = "s3cret-never-shown"
    (tmp_path / "word").write_text(secret + "\n")
    (tmp_path / "graph.yaml").write_text(
        "nodes:\n  board: {use: devices.people.treadmill.Treadmill, realtime: true, duration_s: 3}\n"
        "  lights:\n    use: devices.mqtt.MqttSwitch\n    name: lights\n"
        "    broker: {port: %d, username: me, password_file: word}\n"
    )
    served = Mosquitto(tmp_path, password=secret).start()
    try:
        path = tmp_path / "graph.yaml"
        path.write_text(path.read_text() % served.port)
        for word in (secret, "wrong-" + secret):
            (tmp_path / "word").write_text(word + "\n")
            process = subprocess.Popen(
                [KINEGRAPH, "run", "graph.yaml", "-o", f"s-{len(word)}", "--view", "none", "-v"],
                cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
            seen = (Path("/proc") / str(process.pid) / "cmdline").read_bytes()
            output = process.communicate(timeout=120)[0]
            assert secret.encode() not in output + seen
            with Recording.open(tmp_path / f"s-{len(word)}") as recording:
                assert secret not in json.dumps([recording.header, recording.log], default=str)
            for file in (tmp_path / f"s-{len(word)}").rglob("*"):
                assert file.is_dir() or secret.encode() not in file.read_bytes()
    finally:
        served.stop()
