"""Qualisys' real-time protocol: a documented frame, a server on loopback, bytes cut anywhere, what QTM does not have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.qualisys import protocol as protocol
from kinegraph.devices.qualisys.protocol import QualisysDecoder, QualisysError
from kinegraph.devices.qualisys.simulator import QualisysServer
from kinegraph.devices.qualisys.source import Qualisys
from tests.support.device_feed import check, cut, reading, wait_for

VECTOR = bytes.fromhex(
    "400000000300000015cd5b07000000002a00000001000000280000000100000002000000000000000000803f0000004000004040000080400000a0400000c040"
)
"""A data packet of two markers, as Qualisys' own client reads it."""
SOURCE = Qualisys(markers=("ankle", "knee"), bodies=("shank",), segments=("Fred:Spine", "Fred:Hips"), analog=("EMG 2",))


def test_a_frame_that_qtms_client_reads() -> None:
    ((kind, payload),) = QualisysDecoder().feed(VECTOR)
    frame = protocol.frame(payload)
    assert (kind, frame.time_us, frame.number) == (protocol.DATA, 123456789, 42)
    assert frame.markers.tolist() == [[1, 2, 3], [4, 5, 6]]


@given(st.lists(st.integers(0, 10**6), max_size=6))
def test_packets_cut_anywhere(places: list[int]) -> None:
    decoder, stream = QualisysDecoder(), VECTOR * 3 + protocol.command("text") + VECTOR
    found = [one for piece in cut(stream, places) for one in decoder.feed(piece)]
    assert [kind for kind, _ in found] == [3, 3, 3, 1, 3] and found[3][1] == b"text\0"


@given(st.binary(max_size=200))
def test_garbage_is_refused_never_more(data: bytes) -> None:
    for work in (
        lambda: protocol.frame(data),
        lambda: QualisysDecoder().feed(data),
        lambda: protocol.names(data.decode("latin-1")),
    ):
        try:
            work()
        except QualisysError:
            continue


def test_a_server() -> None:
    with QualisysServer(lose=30) as server:
        source = replace(SOURCE, port=server.port)
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("bodies") > 120)
        wait_for(lambda: "streamframes stop" in server.heard)
    assert feed.error is None, feed.error
    check(source, feed)
    number = feed.data("timing")["counter"]
    first = round(float(feed.data("bodies")[0, 0, 0] * 1000))
    number = (number - number[0] + first)[: feed.count("bodies")]
    assert np.allclose(feed.data("bodies")[:, 0, 0] * 1000, number) and set(feed.lost("bodies").values()) == {1}
    markers, unseen = feed.data("markers")[: len(number)], number % 20 == 19
    assert (np.isnan(markers[:, 1, 0]) == unseen[: len(markers)]).all() and np.allclose(markers[:, 0, 1], 0.1)
    assert feed.data("rotations")[0, 0].tolist() == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    segments = feed.data("segments")[: len(number)]
    assert np.allclose(segments[:, 0, 0] * 1000, number) and np.allclose(segments[:, 0, 1], 0.01)
    assert feed.data("segment_rotations")[0].tolist() == [[0, 0, 0, 1]] * 2
    analog, lost = feed.data("analog")[:, 0], feed.lost("analog")
    steps = np.diff(analog - 0.25) % 1000
    assert {i + 1: int(steps[i]) - 1 for i in np.flatnonzero(steps != 1)} == lost and set(lost.values()) == {10}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"markers": ("nee",)}, "QTM streams no marker 'nee'"),
        ({"rate_hz": 50.0}, "write rate_hz: 100"),
        ({"segments": ("Frad:Hips",)}, "no skeleton 'Frad'"),
        ({"segments": ("Fred:Hip",)}, "no segment of Fred 'Hip'"),
        ({"analog": ("EMG 3",)}, "no analog channel 'EMG 3'"),
        ({"analog_hz": 2000.0}, "write analog_hz: 1000"),
        ({"analog_unit": "mV"}, "gives V, not mV"),
    ],
)
def test_what_qtm_does_not_have_is_told(change: dict[str, object], message: str) -> None:
    with QualisysServer() as server, reading(replace(SOURCE, port=server.port, **change)) as feed:  # type: ignore[arg-type]
        wait_for(lambda: feed.error is not None)
    assert message in str(feed.error)
