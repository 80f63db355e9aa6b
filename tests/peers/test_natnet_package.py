"""natnet (PyPI), a client written elsewhere, reads the simulated server and the capture as we do."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.natnet import protocol as protocol
from kinegraph.devices.natnet.build import build_frame
from kinegraph.devices.natnet.simulator import NatNetScene, NatNetServer
from tests.devices.test_natnet import CAPTURE

natnet = pytest.importorskip("natnet")


def same(theirs: Any, ours: protocol.NatNetFrame) -> None:
    """Every number of both."""
    assert theirs.prefix.frame_number == ours.number
    assert [tuple(p) for p in theirs.unlabeled_marker_pos] == ours.unlabelled
    bodies = [*theirs.rigid_bodies, *(b for s in theirs.skeletons for b in s.rigid_bodies)]
    mine = [*ours.bodies, *(b for bones in ours.skeletons.values() for b in bones)]
    for one, other in zip(bodies, mine, strict=True):
        assert (one.id_num, tuple(one.pos), tuple(one.rot), one.tracking_valid) == (
            other.id, other.position, other.rotation, other.tracked,
        )  # fmt: skip
    for one, other in zip(theirs.labeled_markers, ours.markers, strict=True):
        assert (one.model_id, one.marker_id, tuple(one.pos), one.param) == (
            other.model,
            other.marker,
            other.position,
            other.flags,
        )
    assert np.isclose(theirs.suffix.timestamp, ours.time_s) and theirs.suffix.stamp_camera_mid_exposure == ours.ticks[0]
    plates = [c for plate in theirs.force_plates for c in plate.channel_arrays]
    assert [tuple(c) for c in plates] == [c for channels in ours.analog.values() for c in channels]


def test_the_capture() -> None:
    from natnet.data_frame import DataFrame
    from natnet.packet_buffer import PacketBuffer
    from natnet.version import Version

    theirs = DataFrame.read_from_buffer(PacketBuffer(CAPTURE[4:]), Version(3, 0))
    same(theirs, protocol.frame(CAPTURE[4:], (3, 0)))


@pytest.mark.parametrize("version", [(3, 0), (3, 1), (4, 0), (4, 1)])
def test_the_simulated_server(version: protocol.Version) -> None:
    came: list[Any] = []
    with NatNetServer(NatNetScene(), version) as server:
        client = natnet.NatNetClient("127.0.0.1", "127.0.0.1", command_port=server.port, use_multicast=False)
        client.on_data_frame_received_event.handlers.append(came.append)
        client.connect()
        try:
            for _ in range(200):
                client.update_sync()
                if len(came) > 20:
                    break
                time.sleep(0.02)
        finally:
            client.shutdown()
        assert len(came) > 20
        for theirs in came:
            number = theirs.prefix.frame_number
            same(theirs, protocol.frame(build_frame(server.scene.frame(number), version), version))
