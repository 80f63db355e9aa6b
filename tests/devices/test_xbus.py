"""Xbus: messages written out by hand after the public document, bytes cut anywhere, garbage, damage; commands."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kinegraph.devices.mti import xbus
from kinegraph.devices.mti.xbus import XbusDecoder, XbusFrames, item, message
from tests.support.device_feed import cut

RNG = np.random.default_rng(4)


def measurement(number: int) -> bytes:
    """As an MTi sends it: counter, time, acceleration, angular velocity; every third has a quaternion as well."""
    parts = [
        item(xbus.PACKET_COUNTER, struct.pack(">H", number % 65536)),
        item(xbus.SAMPLE_TIME_FINE, struct.pack(">I", 100 * number)),
        item(xbus.ACCELERATION, struct.pack(">3f", *RNG.normal(0, 10, 3))),
        item(xbus.RATE_OF_TURN, struct.pack(">3f", *RNG.normal(0, 3, 3))),
    ]
    if number % 3 == 0:
        parts.append(item(xbus.QUATERNION, struct.pack(">4f", *RNG.normal(0, 1, 4))))
    return message(xbus.MEASUREMENT, b"".join(parts))


MESSAGES = [measurement(i) for i in range(60)]
STREAM = b"".join(MESSAGES)


def rows(found: list[XbusFrames]) -> list[bytes]:
    """All messages, as bytes."""
    return [row.tobytes() for f in found for run in f.runs for row in run.table]


def decoded(pieces: list[bytes]) -> tuple[list[bytes], int, int]:
    """(messages, bytes dropped, resyncs) of all pieces."""
    decoder = XbusDecoder()
    found = [decoder.feed(piece) for piece in pieces]
    return rows(found), sum(f.dropped for f in found), sum(f.resyncs for f in found)


def test_commands_as_the_document_writes_them() -> None:
    assert message(xbus.GO_TO_CONFIG).hex(" ") == "fa ff 30 00 d1"
    assert message(xbus.GO_TO_MEASUREMENT).hex(" ") == "fa ff 10 00 f1"
    assert message(xbus.REQUEST_DEVICE_ID).hex(" ") == "fa ff 00 00 01"
    wanted = [(xbus.PACKET_COUNTER, xbus.EVERY_PACKET), (xbus.ACCELERATION, 100)]
    data = xbus.configuration(wanted)
    assert message(xbus.OUTPUT_CONFIGURATION, data).hex(" ") == "fa ff c0 08 10 20 ff ff 40 20 00 64 47"
    assert xbus.outputs_of(data) == wanted
    assert xbus.firmware(bytes([1, 8, 2, 0, 0])) == "1.8.2"


def test_a_measurement_written_out_by_hand() -> None:
    """1.0, -2.0, 9.75 as 32-bit floats, 0.5 rad/s in 12.20, 3.25 and -1.5 in 16.32, a quaternion in 64 bits."""
    text = (
        "fa ff 36 62"
        " 10 20 02 01 02"
        " 10 60 04 00 01 00 00"
        " 40 20 0c 3f 80 00 00 c0 00 00 00 41 1c 00 00"
        " 80 21 0c 00 08 00 00 ff f8 00 00 00 10 00 00"
        " c0 22 12 40 00 00 00 00 03 80 00 00 00 ff fe 00 00 00 00 00 01"
        " 20 13 20 3f f0 00 00 00 00 00 00 00 00 00 00 00 00 00 00 bf e0 00 00 00 00 00 00 00 00 00 00 00 00 00 00"
    )
    body = bytes.fromhex(text)
    assert len(body) == 4 + 0x62
    body += bytes([-sum(body[1:]) % 256])
    (run,) = XbusDecoder().feed(body).runs
    assert run.mid == xbus.MEASUREMENT
    assert run.integers(xbus.PACKET_COUNTER).tolist() == [0x0102]
    assert run.integers(xbus.SAMPLE_TIME_FINE).tolist() == [65536]
    assert run.vectors(xbus.ACCELERATION).tolist() == [[1.0, -2.0, 9.75]]
    assert run.vectors(xbus.RATE_OF_TURN).tolist() == [[0.5, -0.5, 1.0]]
    assert run.vectors(xbus.MAGNETIC_FIELD).tolist() == [[3.25, -1.5, 1.0]]
    assert run.vectors(xbus.QUATERNION).tolist() == [[1.0, 0.0, -0.5, 0.0]]
    assert not run.has(xbus.TEMPERATURE)
    with pytest.raises(KeyError, match="0810"):
        run.vectors(xbus.TEMPERATURE)


def test_long_messages() -> None:
    long = message(0x91, bytes(RNG.integers(0, 256, 1000, dtype=np.uint8)))
    assert long[3] == 0xFF and int.from_bytes(long[4:6], "big") == 1000
    many = message(xbus.MEASUREMENT, b"".join(item(0x5070, bytes(100)) for _ in range(4)))
    assert decoded([long + many + MESSAGES[0]]) == ([long, many, MESSAGES[0]], 0, 0)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 46, 47, 48, 200, 10**6])
def test_any_cut_gives_the_same_messages(size: int) -> None:
    assert decoded([STREAM[i : i + size] for i in range(0, len(STREAM), size)]) == (MESSAGES, 0, 0)


def test_messages_of_one_layout_are_taken_at_once() -> None:
    same = [m for i, m in enumerate(MESSAGES) if i % 3]
    assert [len(run) for run in XbusDecoder().feed(b"".join(same)).runs] == [40]


NOISE = st.one_of(
    st.binary(min_size=1, max_size=80),
    st.binary(max_size=12).map(lambda b: xbus.HEAD + b),
    st.binary(max_size=12).map(lambda b: xbus.HEAD + bytes([xbus.MEASUREMENT]) + b),
)


@given(st.lists(st.tuples(st.integers(0, 60), NOISE), max_size=6), st.lists(st.integers(0, 10**4), max_size=12))
@example([(3, bytes.fromhex("fa ff 36 ff 08 00"))], [])
@example([(3, bytes.fromhex("fa ff 36 05 10 20 02 00")), (9, b"\xfa\xff\x36\x01")], [100])
def test_garbage_between_messages_is_passed_over(garbage: list[tuple[int, bytes]], cuts: list[int]) -> None:
    pieces = list(MESSAGES)
    for at, noise in garbage:
        pieces.insert(at, noise)
    data = b"".join(pieces) + bytes(2100)  # what comes last decides over a false beginning
    whole = decoded([data])
    assert decoded([data[i : i + 1] for i in range(len(data))]) == whole
    assert decoded(cut(data, cuts)) == whole
    found = set(whole[0])
    strange = found - set(MESSAGES)
    missing = [m for m in MESSAGES if m not in found]
    if not strange:  # garbage may, once in 256 times, end in what is a message by chance
        assert len(missing) <= len(garbage)


@given(st.integers(1, 57), st.integers(0, 200), st.integers(1, 255))
def test_one_wrong_byte_costs_one_message_and_the_next_is_found_at_once(which: int, where: int, change: int) -> None:
    spoilt = bytearray(MESSAGES[which])
    spoilt[where % len(spoilt)] ^= change
    decoder = XbusDecoder()
    before = rows([decoder.feed(b"".join(MESSAGES[:which]))])
    after = rows(
        [decoder.feed(bytes(spoilt)), decoder.feed(MESSAGES[which + 1]), decoder.feed(MESSAGES[which + 2][:6])]
    )
    assert before == MESSAGES[:which]
    assert after == [MESSAGES[which + 1]]


@given(st.binary(max_size=3000), st.lists(st.integers(0, 3000), max_size=8))
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int]) -> None:
    whole = decoded([data])
    assert decoded(cut(data, cuts)) == whole
    assert sum(map(len, whole[0])) + whole[1] <= len(data)


def test_it_holds_at_most_one_message_back() -> None:
    decoder = XbusDecoder()
    for _ in range(200):
        decoder.feed(RNG.choice([0xFA, 0xFF, 0x36, 0x10, 0x07, 0x00], 1000).astype(np.uint8).tobytes())
        assert len(decoder._buffer) < 7 + xbus.LONGEST
