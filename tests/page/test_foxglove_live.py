"""`--foxglove`: what a client of Foxglove's own protocol sees of a live session, and that only this machine may connect."""

from __future__ import annotations

import json
import re
import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from kinegraph.devices.page.live import FoxgloveLane
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.command_line import KINEGRAPH
from tests.support.page_session import PageProcess

pytest.importorskip("foxglove", reason="no Foxglove SDK here: pip install 'kinegraph[foxglove]'")
pytestmark = [pytest.mark.nightly, pytest.mark.timeout(280)]

GRAPH = """
name: small
record: [active.interval]
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  calf: {use: operators.filters.channels.Select, from: board.emg, channels: [GM, SO]}
  active: {use: operators.filters.threshold.Threshold, from: calf, channel: GM, level: 40, release: 25}
"""
MESSAGE = struct.Struct("<BIQ")
"""Opcode, subscription, stamp (ns)."""


def received(client: ClientConnection, what: str) -> dict[str, Any]:
    while True:
        message = client.recv(timeout=120)
        if isinstance(message, str) and (found := json.loads(message))["op"] == what:
            return dict(found)


class FoxgloveProcess(PageProcess):
    """A session that is served to Foxglove."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self.process, self._log = process, log
        self.url = self.wait_for(re.compile(r"foxglove: (ws://\S+)"))[1]


def test_a_client_of_foxgloves_protocol_gets_what_is_recorded(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(GRAPH)
    log = tmp_path / "output.txt"
    command = [str(KINEGRAPH), "run", "small.yaml", "--view", "none", "-o", "s", "--foxglove"]
    with (
        log.open("w") as out,
        subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=out, stderr=out, text=True) as running,
    ):
        try:
            process = FoxgloveProcess(running, log)
            protocol = [Subprotocol("foxglove.sdk.v1")]
            with connect(process.url, subprotocols=protocol, compression=None, max_size=None) as client:
                assert received(client, "serverInfo")["name"] == "small"
                channels: dict[str, dict[str, Any]] = {}
                while not {"board.emg", "calf", "active.interval"} <= channels.keys():
                    channels |= {c["topic"]: c for c in received(client, "advertise")["channels"]}
                wanted = {1: channels["calf"], 2: channels["active.interval"]}
                asked = [{"id": i, "channelId": channel["id"]} for i, channel in wanted.items()]
                client.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
                found: dict[int, dict[int, dict[str, Any]]] = {1: {}, 2: {}}
                while len(found[1]) < 500 or len(found[2]) < 2:
                    message = client.recv(timeout=120)
                    if isinstance(message, bytes) and message[0] == 1:
                        _, subscription, stamp = MESSAGE.unpack_from(message)
                        found[subscription][stamp] = json.loads(message[MESSAGE.size :])
            assert process.stop() == 0
        finally:
            if running.poll() is None:
                running.kill()
    for number, channel in wanted.items():
        validator = Draft202012Validator(json.loads(channel["schema"]))
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        for one in found[number].values():
            validator.validate(one)
    with Recording.open(tmp_path / "s") as recording:
        time, data = recording.read("board.emg")
        stamps, events = recording.read("active.interval")
        place = [recording.streams["board.emg"].spec.channels.index(name) for name in ("GM", "SO")]
    by_time = dict(zip(time.tolist(), data[:, place].tolist(), strict=True))
    for stamp, one in found[1].items():
        assert [one["GM"], one["SO"]] == by_time[stamp]
    onsets = dict(zip(stamps.tolist(), events["onset"].tolist(), strict=True))
    for stamp, one in found[2].items():
        assert one["onset"]["sec"] * 10**9 + one["onset"]["nsec"] == onsets[stamp]


def test_it_is_served_to_this_machine_alone() -> None:
    graph = load_text(GRAPH)
    with pytest.raises(KinegraphError, match="this machine alone"):
        FoxgloveLane(graph, "0.0.0.0:0")


def test_without_the_sdk_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(KinegraphError, match=r"kinegraph\[foxglove\]"):
        FoxgloveLane(load_text(GRAPH))
