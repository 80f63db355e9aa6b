"""`kinegraph devices` on simulated buses: belts, treadmills, cameras, motion capture."""

from __future__ import annotations

import json
from typing import Any

import pytest

from kinegraph.devices.ble.simulated_radio import radio
from kinegraph.devices.cameras.orbbec_simulator import OrbbecLibrary, camera
from kinegraph.devices.discovery import bluetooth
from kinegraph.devices.dot.simulator import DotSensor
from kinegraph.devices.fitness_treadmill.simulator import FtmsBelt
from kinegraph.devices.natnet import discovery as natnet
from kinegraph.devices.natnet.simulator import NatNetScene, NatNetServer
from kinegraph.devices.polar.simulator import PolarBelt
from kinegraph.stream.graph.reading.load import load_text
from tests.support.command_line import Command


def nodes(found: list[dict[str, Any]]) -> list[str]:
    """The classes that read what was found; each node is one that a graph may hold."""
    used = []
    for one in found:
        lines = "".join(f"    {line}\n" for line in one["yaml"].splitlines())
        graph = load_text(f"nodes:\n  it:\n{lines}")
        used.append(type(graph.nodes["it"].part).__name__)
    return used


def test_what_advertises_is_found(kinegraph: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("bleak")
    monkeypatch.setattr(bluetooth, "SCAN_S", 0.2)
    with radio() as air:
        for one in (PolarBelt(), DotSensor(), FtmsBelt()):
            air.put(one)
        code, out, _ = kinegraph("devices", "ble", "--json")
    assert code == 0
    assert nodes(json.loads(out)) == ["Polar", "MovellaDot", "FtmsTreadmill"]


def test_an_orbbec_camera_is_found(kinegraph: Command) -> None:
    with camera(OrbbecLibrary()):
        code, out, _ = kinegraph("devices", "orbbec", "--json")
    assert code == 0 and nodes(json.loads(out)) == ["Orbbec"]


def test_a_natnet_server_is_found_with_what_it_streams(kinegraph: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    with NatNetServer(NatNetScene(), (4, 1)) as server:
        monkeypatch.setattr(natnet, "AT", [("127.0.0.1", server.port)])
        code, out, _ = kinegraph("devices", "natnet", "--json")
    (found,) = json.loads(out)
    assert code == 0 and nodes([found]) == ["NatNet"]
    assert found["what"] == "Motive 3.1.0.0 (NatNet 4.1, unicast), 3 rigid bodies and bones"
    assert 'bodies: ["Shank", "Fred:Hips", "Fred:LThigh"]' in found["yaml"]
