"""Bluetooth LE protocols, bytes in and numbers out: published vectors and captures, cut anywhere, and garbage."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.dot import protocol as movella_dot
from kinegraph.devices.fitness_treadmill import protocol as ftms
from kinegraph.devices.ganglion import protocol as ganglion
from kinegraph.devices.ganglion.protocol import GanglionDecoder
from kinegraph.devices.heart_rate import protocol as heart_rate
from kinegraph.devices.heart_rate.protocol import HeartRateMeasurement
from kinegraph.devices.polar import protocol as polar_pmd
from kinegraph.devices.polar.protocol import PmdDecoder


def test_heart_rate_vectors_of_the_polar_sdk() -> None:
    assert heart_rate.parse(bytes.fromhex("08007F80")) == HeartRateMeasurement(0, None, 32895, ())
    reported = heart_rate.parse(bytes.fromhex("110000FFFF7F80"))
    assert reported is not None and reported.rr_s == (65535 / 1024, 32895 / 1024)


@given(
    st.integers(0, 400), st.sampled_from([None, True, False]), st.none() | st.integers(0, 65535),
    st.lists(st.integers(0, 65535), max_size=5),
)  # fmt: skip
def test_what_a_belt_sends_is_what_is_read(bpm: int, contact: bool | None, energy: int | None, rr: list[int]) -> None:
    reported = HeartRateMeasurement(bpm, contact, energy, tuple(ticks / 1024 for ticks in rr))
    assert heart_rate.parse(heart_rate.build(reported)) == reported


def test_polar_vectors_of_the_sdk() -> None:
    decoder = PmdDecoder()
    ecg = decoder.frame(bytes.fromhex("000094357700000000000280FF028000"))
    assert ecg is not None and ecg.last_ns == 2 * 10**9 and ecg.data.ravel().tolist() == [-32766, 32770]
    head = bytes.fromhex("020094357700000000")
    acc = decoder.frame(head + b"\x01" + bytes.fromhex("F7FFFFFFE703F8FFFEFFE503"))
    assert acc is not None and np.allclose(acc.data * 1000, [(-9, -1, 999), (-8, -2, 997)])
    packed = bytes.fromhex("F1FF1400F00306017B0F08")
    wanted = [(-15, 20, 1008), (-20, 17, 1008)]
    assert np.array_equal(polar_pmd.unpacked(packed, 3), wanted)  # type: ignore[arg-type]
    decoder.started(bytes.fromhex("F0020200000501") + np.float32(0.5).tobytes())
    for form, scale in ((0x81, 0.0005), (0x80, 0.5)):
        frame = decoder.frame(head + bytes([form]) + packed)
        assert frame is not None and np.allclose(frame.data, np.array(wanted) * scale)
    assert polar_pmd.start(0, rate=130, resolution=14).hex() == "02000001820001010e00"
    assert polar_pmd.start(2, rate=200, resolution=16, range=8).hex() == "02020001c8000101100002010800"
    assert polar_pmd.unix_ns(599_616_000 * 10**9) == 1_546_300_800 * 10**9, "2019-01-01"


@given(st.integers(1, 700), st.integers(4, 12), st.integers(0, 2**31))
def test_compressed_frames_come_back(n: int, bits: int, seed: int) -> None:
    half = 1 << bits - 1
    steps = np.random.default_rng(seed).integers(-half, half, (n, 3))
    rows = np.cumsum(np.vstack([[0, -20, 1000], steps]), axis=0)
    assert np.array_equal(polar_pmd.unpacked(polar_pmd.packed(rows, bits), 3), rows)  # type: ignore[arg-type]


def test_dot_capture_of_node_movella_dot() -> None:
    parsed = movella_dot.parse(movella_dot.MODES["free"], bytes.fromhex("d8052244af9640406b2aa7405add14c000000000"))
    assert parsed is not None and parsed[0] == 1143080408
    assert np.allclose(parsed[1], (3.009197, 5.223928, -2.326010), atol=1e-6)


def test_damage_that_more_mutants_found() -> None:
    """A compressed frame with an empty block was a traceback, and a signalling NaN a warning."""
    assert polar_pmd.unpacked(bytes(6) + bytes([8, 0, 8, 1, 1, 1, 1]), 3) is None
    parsed = movella_dot.parse(movella_dot.MODES["free"], bytes(4) + bytes.fromhex("9976967f") + bytes(12))
    assert parsed is not None and np.isnan(parsed[1][0])


def test_ganglion_vectors() -> None:
    """OpenBCI's own: the sign stands in the lowest bit (BrainFlow reads those numbers otherwise)."""
    low = ganglion.fields(bytes.fromhex("010000000020002800048000BC00070028C00A0E"), 18)
    assert low.tolist() == [[0, 2, 10, 4], [131074, 245760, 114698, 49162]]
    high = ganglion.fields(bytes.fromhex("65FFFFBFFFEFFFFCFFFF58000B3E38E0003FF001"), 19)
    assert high.tolist() == [[-3, -5, -7, -11], [-262139, -198429, -262137, -4095]]
    assert pytest.approx(1.2e6 / (8388607 * 1.5 * 51)) == ganglion.UV


def test_ganglion_differences_are_taken_off() -> None:
    decoder = GanglionDecoder(2)
    decoder.feed(bytes([0]) + (1000).to_bytes(3, "big") * 4 + bytes(7))
    packet = decoder.feed(bytes.fromhex("010000000020002800048000BC00070028C00A0E"))
    assert packet is not None and packet.rows.tolist()[0] == [1000, 998, 990, 996]
    assert (packet.axis, round(packet.acceleration_g, 3)) == (0, 0.224)
    assert decoder.feed(bytes.fromhex("030000000020002800048000BC00070028C00A0E")) is None and decoder.unknown == 1


def test_treadmill_capture() -> None:
    reported = ftms.parse(bytes.fromhex("9C25") + bytes(24))
    assert reported is not None and not reported.more
    assert set(reported.values) >= {
        "speed",
        "distance",
        "incline",
        "climbed",
        "energy",
        "heart_rate",
        "elapsed",
        "steps",
    }
    assert reported.values["speed"] == 0 and "pace" not in reported.values
    more = ftms.parse(bytes.fromhex("0100"))
    assert more is not None and more.more and more.values == {}


def test_treadmill_commands_are_those_of_the_service() -> None:
    assert ftms.target(ftms.SPEED, 1.05).hex() == "026900" and ftms.target(ftms.INCLINE, -2.5).hex() == "03e7ff"
    assert ftms.limits(bytes.fromhex("500040060a00"), signed=False, factor=0.01) == pytest.approx((0.8, 16.0, 0.1))
    assert ftms.can_be_set(bytes(4) + b"\x01\0\0\0") == (True, False)


@given(st.binary(max_size=64))
def test_no_bytes_break_a_parser(data: bytes) -> None:
    heart_rate.parse(data)
    PmdDecoder().frame(data)
    ftms.parse(data)
    for firmware in (2, 3):
        GanglionDecoder(firmware).feed(data)
    for mode in movella_dot.MODES.values():
        movella_dot.parse(mode, data)
    for kind in (b"\x02" + bytes(8) + b"\x80", b"\x02" + bytes(8) + b"\x01", bytes(9) + b"\0"):
        PmdDecoder().frame(kind + data)
