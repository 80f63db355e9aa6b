"""NatNet 3.0 to 4.2: a capture, frames that come back, a server on loopback by unicast and multicast, and what goes wrong."""

from __future__ import annotations

import socket
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.natnet import protocol as protocol
from kinegraph.devices.natnet.build import build_frame, build_models
from kinegraph.devices.natnet.protocol import NatNetError, Version
from kinegraph.devices.natnet.simulator import MODELS, NatNetScene, NatNetServer
from kinegraph.devices.natnet.source import NatNet
from kinegraph.devices.simulation.fault_injection import FaultInjection
from tests.support.device_feed import check, reading, wait_for

VERSIONS: list[Version] = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]
CAPTURE = bytes.fromhex(
    "07004c01ae7b02000000000005000000f844023ebea4c03fa6c562bf3800563e24dcbd3fdd5136bf965b3bbd6a2cb73f39d054bfbeb0393e67c9b73ff45127bf"
    "668ea43e4b13b53f94c140bf010000000200000024a2323e9a3bb93f59fb3bbf349e5fbdf78b023f8402333dcb7b5bbfda0f073a010000000000060000000100"
    "0200f844023ebea4c03fa6c562bf90a2af3c0a00c08f5939020002003800563e24dcbd3fdd5136bf9416ab3c0a0038500d3a03000200965b3bbd6a2cb73f39d0"
    "54bfcb77aa3c0a00e5a5343a04000200beb0393e67c9b73ff45127bf16db9d3c0a00032fc93905000200668ea43e4b13b53f94c140bf82dfad3c0a00b5a7263a"
    "57c3000040e92e3ef9fac03f9e1957bf0421a53c12003ea3123a000000000000000000000000000000007777777777309540d613d8cd49010000904fd8cd4901"
    "0000f25ad8cd49010000000000000000"
)
"""A frame of version 3.0, as the library python_natnet holds it among its tests."""
SOURCE = NatNet(
    server="127.0.0.1", local="127.0.0.1", bodies=("Fred:LThigh", "Shank"), markers=("Shank:1", "Shank:2"),
    analog=("plate 1:Fz", "plate 1:1"), analog_samples=5,
)  # fmt: skip


def test_a_capture() -> None:
    kind, payload = protocol.opened(CAPTURE)
    frame = protocol.frame(payload, (3, 0))
    assert (kind, frame.number, len(frame.unlabelled), len(frame.markers)) == (protocol.FRAME, 162734, 5, 6)
    (body,) = frame.bodies
    assert body.id == 2 and body.tracked and body.error == pytest.approx(0.000515, abs=1e-6)
    assert np.allclose(body.position, (0.174447, 1.447131, -0.734304), atol=1e-6)
    assert np.allclose(body.rotation, (-0.054594, 0.509948, 0.043704, -0.857358), atol=1e-6)
    assert [(m.model, m.marker, m.flags) for m in frame.markers][::5] == [(2, 1, 10), (0, 50007, 18)]
    assert frame.time_s == pytest.approx(1356.116667, abs=1e-6)
    assert frame.ticks == (1416497730518, 1416497745808, 1416497748722)


@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_sent_is_what_is_read(version: Version) -> None:
    for number in (0, 49, 99, 12345):
        frame = NatNetScene().frame(number)
        read = protocol.frame(build_frame(frame, version), version)
        assert read.number == number and read.ticks == frame.ticks and read.analog == frame.analog
        for ours, theirs in zip((*read.bodies, *read.skeletons[2]), (*frame.bodies, *frame.skeletons[2]), strict=True):
            assert (ours.id, ours.tracked) == (theirs.id, theirs.tracked)
            assert np.allclose(ours.position, theirs.position) and np.allclose(ours.rotation, theirs.rotation)
        assert np.allclose([m.position for m in read.markers], [m.position for m in frame.markers])
    models = protocol.models(build_models(MODELS, version), version)
    assert (models.bodies, models.skeletons, models.analog) == (MODELS.bodies, MODELS.skeletons, MODELS.analog)
    assert models.markers[7] == (MODELS.markers[7] if version >= (4, 0) else [])


def test_a_kind_of_model_that_is_not_known_is_passed_over() -> None:
    payload = bytearray(build_models(MODELS, (4, 2)))
    payload[:4] = (len(MODELS.sets) + 3 + 1).to_bytes(4, "little")
    payload += (77).to_bytes(4, "little") + (5).to_bytes(4, "little") + b"later"
    assert protocol.models(bytes(payload), (4, 2)).bodies == MODELS.bodies


@given(st.integers(0, 400), st.sampled_from(VERSIONS))
def test_a_frame_cut_anywhere_is_refused(length: int, version: Version) -> None:
    whole = build_frame(NatNetScene().frame(3), version)
    with pytest.raises(NatNetError):
        protocol.frame(whole[: min(length, len(whole) - 5)], version)


@given(st.binary(max_size=400), st.sampled_from(VERSIONS))
def test_garbage_is_refused_never_more(data: bytes, version: Version) -> None:
    for read in (
        lambda: protocol.frame(data, version),
        lambda: protocol.models(data, version),
        lambda: protocol.server_info(data),
    ):
        try:
            read()
        except NatNetError:
            continue


@pytest.mark.parametrize("multicast", [False, True])
@pytest.mark.parametrize("version", [(3, 0), (4, 2)])
def test_a_server(version: Version, multicast: bool) -> None:
    with NatNetServer(NatNetScene(), version, multicast=multicast) as server:
        source = replace(SOURCE, port=server.port)
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("bodies") > 220)
    assert feed.error is None, feed.error
    check(source, feed)
    positions, markers = feed.data("bodies"), feed.data("markers")
    number = (
        np.asarray(feed.data("timing")["counter"]) + int(positions[0, 0, 2]) - int(feed.data("timing")["counter"][0])
    )
    number = number[: len(positions)]
    assert (positions[:, 0, 2] == number % 500).all(), "bones"
    lost = number % 100 == 99
    assert (
        (np.isnan(positions[:, 1, 0]) == lost).all() and lost.any() and np.isnan(feed.data("rotations")[lost, 1]).all()
    )
    seen = ~lost
    assert (positions[seen, 1, 0] % 500 == number[seen] % 500).all(), "the first frame is known up to 500"
    norms = np.linalg.norm(feed.data("rotations")[seen, 1], axis=1)
    assert np.allclose(norms, 1) and (feed.data("rotations")[seen, 1, 0] > 0.9).all(), "w comes first"
    assert (np.isnan(markers[:, 1, 0]) == (number[: len(markers)] % 50 == 49)).all()
    plate = feed.data("analog")
    assert (np.diff(plate[:, 1]) == 1).sum() > len(plate) - 3 and np.allclose(plate[:, 0] - plate[:, 1], 2000)
    assert not {"lost frame", "cut message", "no NatNet message"} & set(feed.problems)


def test_frames_lost_are_known_from_their_number_and_doubled_ones_left_out() -> None:
    with NatNetServer(NatNetScene(), (3, 1), faults=FaultInjection(lose=0.05, duplicate=0.05, seed=1)) as server:
        source = replace(SOURCE, port=server.port, analog=(), markers=())
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("bodies") > 200)
    lost, bones = feed.lost("bodies"), feed.data("bodies")[:, 0, 2]
    assert {i: int(step) - 1 for i, step in enumerate(np.diff(bones) % 500, 1) if step != 1} == lost and lost
    assert feed.problems["lost frame"] == sum(lost.values()) and feed.problems["repeated frame or wrong time"]


def test_a_server_that_has_started_again_is_heard_again() -> None:
    with NatNetServer(NatNetScene(), (3, 1)) as server:
        port = server.port
        with reading(replace(SOURCE, port=port)) as feed:
            wait_for(lambda: feed.error is not None or feed.count("bodies") > 10)
            server.close()
            before = feed.count("bodies")
            with NatNetServer(NatNetScene(), (4, 1), port=port):
                wait_for(lambda: feed.error is not None or feed.count("bodies") > before + 20)
    assert feed.error is None and len(feed.lost("bodies")) == 1, "one gap"


def test_what_the_server_does_not_stream_is_told() -> None:
    with NatNetServer(NatNetScene()) as server, reading(replace(SOURCE, port=server.port, bodies=("Shenk",))) as feed:
        wait_for(lambda: feed.error is not None)
    assert "Motive streams no rigid body or bone 'Shenk'" in str(feed.error) and "Shank" in str(feed.error)


def test_nobody_there_and_a_version_too_old() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        with reading(replace(SOURCE, port=silent.getsockname()[1])) as feed:
            wait_for(lambda: feed.error is not None)
    assert "does Motive stream" in str(feed.error)
    with NatNetServer(NatNetScene(), (2, 9)) as server, reading(replace(SOURCE, port=server.port)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "speaks NatNet 2.9; 3.0 or newer is needed" in str(feed.error)


def test_a_rate_that_is_not_motives_ends_the_session() -> None:
    with NatNetServer(NatNetScene(rate_hz=240.0)) as server, reading(replace(SOURCE, port=server.port)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "it sends 240 samples a second, not 120" in str(feed.error)


def test_it_runs_without_hardware() -> None:
    source = replace(
        SOURCE, bodies=("Any", "Sam:Hips"), markers=("Any:knee", "Other:3"), analog=("device 4:2",), analog_samples=2
    )
    device = source.simulated()
    assert device is not None
    with device as there, reading(there) as feed:
        wait_for(lambda: feed.error is not None or feed.count("analog") > 20)
    assert feed.error is None, feed.error
    assert np.isfinite(feed.data("bodies")[:5]).all() and np.isfinite(feed.data("markers")[:5]).all()
