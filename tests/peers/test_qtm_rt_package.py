"""qtm-rt, Qualisys' own client, reads the simulated server as we do."""

from __future__ import annotations

import asyncio
import warnings
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.qualisys import protocol as protocol
from kinegraph.devices.qualisys.simulator import QualisysServer

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    qtm_rt = pytest.importorskip("qtm_rt")


async def _listen(port: int) -> list[Any]:
    came: list[Any] = []
    connection = await qtm_rt.connect("127.0.0.1", port=port, version="1.25")
    assert connection is not None
    assert "<Name>knee</Name>" in (await connection.get_parameters(parameters=["3d"])).decode()
    await connection.stream_frames(
        frames="allframes", components=["3d", "6d", "analog", "skeleton:global"], on_packet=came.append
    )
    while len(came) < 25:
        await asyncio.sleep(0.02)
    connection.disconnect()
    return came


@pytest.mark.timeout(60)
def test_their_numbers_are_ours() -> None:
    with QualisysServer() as server:
        came = asyncio.run(_listen(server.port))
        for packet in came:
            ours = protocol.frame(protocol.build_data(server.frame(packet.framenumber)))
            assert packet.timestamp == ours.time_us
            _, markers = packet.get_3d_markers()
            assert np.array_equal([tuple(m) for m in markers], ours.markers, equal_nan=True)
            _, bodies = packet.get_6d()
            theirs = [(*position, *rotation.matrix) for position, rotation in bodies]
            assert np.array_equal(np.array(theirs, np.float32), ours.bodies)
            analog = packet.get_analog()[1]
            device, first, _ = analog[0]
            (samples,) = ours.analog
            assert (device.id, first.sample_number) == (1, samples.first)
            assert np.array_equal(np.array([channel.samples for _, _, channel in analog], np.float32).T, samples.values)
            (segments,) = packet.get_skeletons()[1]
            theirs = {number: (*position, *rotation) for number, position, rotation in segments}
            assert theirs.keys() == ours.skeletons[0].keys()
            assert all(np.array_equal(np.array(row, np.float32), ours.skeletons[0][k]) for k, row in theirs.items())
