"""OSC in, as python-osc sends it: declared by address and arguments, lost and doubled messages, what is no OSC; and ZeroMQ messages."""

from __future__ import annotations

import socket
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.frames.source import Binary
from kinegraph.devices.osc.inlet import OscInlet
from kinegraph.devices.osc.simulator import OscModel, serving
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command
from tests.support.device_feed import check, free_udp_port, is_bound, reading, wait_for

osc = pytest.importorskip("pythonosc.udp_client")
STREAM = {
    "name": "motion",
    "address": "/imu",
    "rate_hz": 100,
    "arguments": [{"role": "counter"}, {}, {"name": "ax", "unit": "g", "scale": 0.5}, {"name": "ay", "unit": "g"}],
}


def until(monotonic_s: float) -> None:
    """Sleep until then, so that a rate is kept on average whatever holds the test up."""
    time.sleep(max(0.0, monotonic_s - time.monotonic()))


def inlet(**more: Any) -> OscInlet:
    return build(OscInlet, {"streams": [STREAM], "port": free_udp_port(), **more})


def test_what_python_osc_sends_is_read() -> None:
    source = inlet()
    sender = osc.SimpleUDPClient("127.0.0.1", source.port)
    with reading(source) as feed:
        wait_for(lambda: is_bound(source.port))
        began = time.monotonic()
        for i in range(80):
            until(began + i / 100)
            if i not in (20, 21):
                sender.send_message("/imu", [i, "text", i / 2, -i, 99.0])
            if i == 30:
                sender.send_message("/imu", [i, "text", i / 2, -i])
                sender.send_message("/imu", [1, "two", "three", 4])
                sender.send_message("/other", [1])
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
                    out.sendto(b"hello", ("127.0.0.1", source.port))
        wait_for(lambda: feed.count("motion") >= 78)
    check(source, feed)
    sent = [i for i in range(80) if i not in (20, 21)]
    assert feed.data("motion").tolist() == [[i / 4, -i] for i in sent]
    assert feed.lost("motion") == {20: 2}
    assert dict(feed.problems) == {
        "lost message": 2, "not OSC": 1, "message with something else than a number": 1, "repeated message or wrong time": 1,
        "message of an address that no stream takes": 1,
    }  # fmt: skip
    sender._sock.close()


def test_the_senders_time_is_followed() -> None:
    arguments = [{"role": "time", "unit": "ms"}, {"name": "x"}]
    source = inlet(streams=[{"name": "a", "address": "/a", "rate_hz": 50, "arguments": arguments}])
    sender = osc.SimpleUDPClient("127.0.0.1", source.port)
    with reading(source) as feed:
        wait_for(lambda: is_bound(source.port))
        began = time.monotonic()
        for i in range(20):
            until(began + 0.06 * i)
            for k in range(3):
                sender.send_message("/a", [20.0 * (3 * i + k), float(i)])
        wait_for(lambda: feed.count("a") == 60)
    steps = np.diff(feed.time("a")) / 1e6
    assert np.median(np.abs(steps - 20)) < 0.01, "though three came at a time"
    sender._sock.close()


def test_a_network_that_loses_and_doubles() -> None:
    source = inlet()
    with serving(OscModel(source), FaultInjection(lose=0.05, duplicate=0.05, seed=2)) as port:
        source = replace(source, port=port)
        with reading(source) as feed:
            wait_for(lambda: feed.count("motion") > 300)
    check(source, feed)
    assert feed.problems["lost message"] > 3 and feed.problems["repeated message or wrong time"] > 3
    steps = np.diff(feed.time("motion"))[100:]
    assert np.median(np.abs(steps / 1e7 - 1)) < 0.05, "though two or three are read at once"


def test_it_runs_without_its_sender(kinegraph: Command, tmp_path: Path) -> None:
    streams = (
        "[{name: a, address: /a, rate_hz: 120, arguments: [{role: time, unit: ms}, {name: x}]}, "
        "{name: b, address: /b, rate_hz: 30, arguments: [{role: counter}, {name: y}]}]"
    )
    (tmp_path / "osc.yaml").write_text(f"nodes:\n  net:\n    use: devices.osc.OscInlet\n    streams: {streams}\n")
    code, _, complaint = kinegraph("run", "osc.yaml", "--simulate", "--for", "3", "-o", "session", "--view", "none")
    assert code == 0, complaint
    with Recording.open(tmp_path / "session") as recording:
        samples = {name: stream.samples for name, stream in recording.streams.items()}
    assert samples["net.a"] > 150 and samples["net.b"] > 40


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "timing"}, "not 'timing'"), ({"address": "imu"}, "begins with a slash"), ({"arguments": [{}]}, "at least one named"),
        ({"arguments": [{"name": "x"}, {"role": "time", "unit": "days"}]}, "a unit out of"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        inlet(streams=[STREAM | change]).specs()


def test_a_port_that_is_taken_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with reading(inlet(port=other.getsockname()[1])) as feed:
            wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "cannot be bound" in str(feed.error)


def test_zeromq_messages_are_declared_as_frames_are() -> None:
    zmq = pytest.importorskip("zmq")
    fields = [{"type": "u32", "role": "counter"}, {"type": "f32", "name": "x"}]
    frame = {"name": "m", "sync": "", "rate_hz": 100, "fields": fields}
    context = zmq.Context()
    out = context.socket(zmq.PUB)
    port = out.bind_to_random_port("tcp://127.0.0.1")
    source = build(Binary, {"port": f"zmq+tcp://127.0.0.1:{port}?topic=imu", "frames": [frame]})
    try:
        with reading(source) as feed:
            i, began = 0, time.monotonic()
            while feed.count("m") < 60 and feed.error is None:
                out.send_multipart([b"imu", struct.pack("<If", i, i / 2)])
                out.send_multipart([b"other", b"garbage"])
                i += 1
                until(began + i / 100)
    finally:
        out.close(0)
        context.term()
    assert feed.error is None, feed.error
    check(source, feed)
    values = feed.data("m")[:, 0]
    assert np.diff(values).tolist() == [0.5] * (len(values) - 1) and not feed.problems


def test_a_zeromq_address_that_is_none() -> None:
    pytest.importorskip("zmq")
    fields = [{"type": "f32", "name": "x"}]
    with reading(
        build(Binary, {"port": "zmq+nowhere", "frames": [{"name": "m", "sync": "", "fields": fields}]})
    ) as feed:
        wait_for(lambda: feed.error is not None)
    assert "cannot be subscribed to" in str(feed.error)
