"""Declared frames as UDP datagrams: packed by another program, lost and doubled by the network, and addresses that cannot be bound."""

from __future__ import annotations

import socket
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.frames.datagram_simulator import sending
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.devices.transport.transport import connect
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command
from tests.support.device_feed import check, free_udp_port, is_bound, reading, wait_for

MOTION = {
    "name": "motion",
    "sync": "",
    "rate_hz": 100,
    "endian": "big",
    "fields": [{"type": "u32", "role": "counter"}, *({"type": "f32", "name": name} for name in ("ax", "ay", "az"))],
}


def phone(port: str = "udp://127.0.0.1:9000", **more: Any) -> Binary:
    return build(Binary, {"port": port, "frames": [MOTION], **more})


def test_what_another_program_packs_is_read_as_it_is() -> None:
    port = free_udp_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out, reading(phone(f"udp://127.0.0.1:{port}")) as feed:
        wait_for(lambda: is_bound(port))
        for i in range(60):
            if i not in (20, 21):
                out.sendto(struct.pack("!Ifff", i, i / 2, -i, 9.81), ("127.0.0.1", port))
            if i == 30:
                out.sendto(b"hello", ("127.0.0.1", port))
            time.sleep(0.01)
        wait_for(lambda: feed.count("motion") >= 58)
    assert feed.data("motion")[:, 0].tolist() == [i / 2 for i in range(60) if i not in (20, 21)]
    assert feed.lost("motion") == {20: 2}
    assert dict(feed.problems) == {"lost frame": 2, "bytes that are no frame": 5}


def test_a_network_that_loses_and_doubles() -> None:
    source = phone()
    with sending(BinaryModel(source), FaultInjection(lose=0.05, duplicate=0.05, seed=2)) as port:
        source = replace(source, port=port)
        with reading(source) as feed:
            wait_for(lambda: feed.count("motion") > 300)
    check(source, feed)
    assert feed.problems["lost frame"] > 3 and feed.problems["repeated frame or wrong time"] > 3


def test_it_runs_without_hardware(kinegraph: Command, tmp_path: Path) -> None:
    fields = "[{type: u8, role: counter}, {type: i12, name: a}, {type: i12, name: b}]"
    (tmp_path / "udp.yaml").write_text(
        "nodes:\n  net:\n    use: devices.frames.Binary\n    port: udp://127.0.0.1:9000\n"
        f"    frames: [{{name: m, sync: '', rate_hz: 50, samples: 2, fields: {fields}}}]\n"
    )
    code, _, complaint = kinegraph("run", "udp.yaml", "--simulate", "--for", "2", "-o", "session", "--view", "none")
    assert code == 0, complaint
    with Recording.open(tmp_path / "session") as recording:
        (stream,) = [s for name, s in recording.streams.items() if name.startswith("net") and "timing" not in name]
    assert stream.spec.rate_hz == 100 and stream.samples > 50


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(DeviceError, match="another program listens there"):
            connect(f"udp://127.0.0.1:{other.getsockname()[1]}")


@pytest.mark.parametrize("address", ["udp://9000", "udp://127.0.0.1:http", "udp://127.0.0.1:70000"])
def test_an_address_that_is_none(address: str) -> None:
    with pytest.raises(DeviceError, match="is not an address to listen at"):
        connect(address)


@pytest.mark.parametrize(
    ("more", "message"), [({"start": ["01"]}, "start"), ({"framing": "cobs"}, "each datagram is a frame")]
)
def test_what_has_no_meaning_for_datagrams_is_refused(more: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        phone(**more).specs()


def test_stamps_are_even() -> None:
    source = phone()
    with sending(BinaryModel(source)) as port, reading(replace(source, port=port)) as feed:
        wait_for(lambda: feed.count("motion") > 200)
    assert np.median(np.abs(np.diff(feed.time("motion")) / 1e7 - 1)) < 0.05
