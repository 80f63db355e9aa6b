"""Declared binary frames: checksums, field types, cuts, garbage; the source against a simulated device, the WT901 by its manual."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.frames.checksum_fit import fitting
from kinegraph.devices.frames.checksums import CHECKSUMS
from kinegraph.devices.frames.declared import Field, Frame
from kinegraph.devices.frames.decoder import FrameDecoder
from kinegraph.devices.frames.layout import FrameLayout
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.params import build
from tests.support.device_feed import Kept, check, cut, reading, wait_for

WITMOTION = Path(__file__).resolve().parents[2] / "configs" / "witmotion.yaml"
PAIR = (
    Frame(
        "A5 5A",
        (Field("u8", role="counter"), Field("i16", "x"), Field("i16", "y")),
        "motion",
        checksum="sum8",
        rate_hz=100.0,
    ),
    Frame("A5 5B", (Field("u16", "level", scale=0.1, unit="V"),), "battery", endian="big", checksum="crc16_modbus"),
)


# checksums and fields ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("sum8", 0xDD), ("zero_sum8", 0x23), ("xor8", 0x31), ("sum16", 0x01DD), ("crc8", 0xF4), ("crc16_modbus", 0x4B37),
        ("crc16_ccitt", 0x29B1), ("crc16_xmodem", 0x31C3), ("crc32", 0xCBF43926), ("fletcher8", 0x15DD),
    ],
)  # fmt: skip
def test_checksums_have_their_published_values(kind: str, value: int) -> None:
    """Of the text "123456789", as catalogues of checksums give it."""
    assert CHECKSUMS[kind].of(b"123456789") == value
    assert value < 1 << 8 * CHECKSUMS[kind].size


def test_fields_of_every_type_and_byte_order_against_struct() -> None:
    kinds = {
        "u8": "B",
        "i8": "b",
        "u16": "H",
        "i16": "h",
        "u32": "I",
        "i32": "i",
        "u64": "Q",
        "i64": "q",
        "f32": "f",
        "f64": "d",
    }
    rng = np.random.default_rng(1)
    for endian, mark in (("little", "<"), ("big", ">")):
        frame = Frame("7E", tuple(Field(kind, kind) for kind in kinds), "all", endian=endian)  # type: ignore[arg-type]
        body = rng.integers(0, 128, struct.calcsize(mark + "".join(kinds.values())), dtype=np.uint8).tobytes()
        layout = FrameLayout(frame)
        values = layout.values(layout.table(b"\x7e" + body))
        assert values[0].tolist() == [float(v) for v in struct.unpack(mark + "".join(kinds.values()), body)]


@pytest.mark.parametrize("endian", ["little", "big"])
def test_numbers_of_24_bits(endian: str) -> None:
    layout = FrameLayout(Frame("7E", (Field("i24", "a"), Field("u24", "b")), "x", endian=endian))  # type: ignore[arg-type]
    for value in (0, 1, -1, 2**23 - 1, -(2**23), -123456):
        body = value.to_bytes(3, endian, signed=True) * 2  # type: ignore[arg-type]
        assert layout.values(layout.table(b"\x7e" + body))[0].tolist() == [value, value % 2**24]
        assert layout.build({0: value, 1: value % 2**24}) == b"\x7e" + body


def test_an_array_is_so_many_channels() -> None:
    fields = [
        {"type": "u8", "role": "counter"},
        {"type": "i16", "name": "ch", "count": 3, "scale": 0.5, "unit": "uV"},
        {"type": "u8", "count": 2},
        {"type": "u8", "name": "battery"},
    ]
    source = build(
        Binary,
        {"port": "a", "frames": [{"name": "emg", "sync": "A5", "rate_hz": 100, "fields": fields, "checksum": "sum8"}]},
    )
    assert source.specs()["emg"].channels == ("ch1", "ch2", "ch3", "battery")
    assert source.specs()["emg"].units == ("uV", "uV", "uV", "")
    (layout,) = source.layouts()
    body = bytes.fromhex("A5 07 0200 0400 FEFF 0000 09")
    found = FrameDecoder([layout]).feed(body + bytes([sum(body) % 256]))
    assert layout.values(layout.table(bytes(found.frames[0]))).tolist() == [[1.0, 2.0, -1.0, 9.0]]
    assert replace(source.frames[0]) == source.frames[0]


def test_scale_offset_and_a_byte_order_of_its_own() -> None:
    fields = (Field("u16", "t", scale=0.01, offset=-40.0, unit="degC"), Field("u16", "p", endian="big"), Field("u16"))
    layout = FrameLayout(Frame("01", fields, "air"))
    assert layout.values(layout.table(b"\x01\x10\x27\x01\x02\xff\xff")).tolist() == [[60.0, 258.0]]


# the decoder ---------------------------------------------------------------------------------------------------------


def decoded(
    pieces: list[bytes], frames: tuple[Frame, ...] = PAIR
) -> tuple[list[int], dict[int, bytes], tuple[int, int, int]]:
    decoder = FrameDecoder([FrameLayout(f) for f in frames])
    kinds: list[int] = []
    bodies: dict[int, bytes] = {}
    counts = [0, 0, 0]
    for piece in pieces:
        found = decoder.feed(piece)
        kinds += found.kinds
        for kind, data in found.frames.items():
            bodies[kind] = bodies.get(kind, b"") + bytes(data)
        counts = [a + b for a, b in zip(counts, (found.bad, found.dropped, found.resyncs), strict=True)]
    return kinds, bodies, (counts[0], counts[1], counts[2])


def made(n: int, frames: tuple[Frame, ...] = PAIR) -> list[bytes]:
    """Frames of both kinds in turn, with random numbers."""
    rng, layouts = np.random.default_rng(2), [FrameLayout(f) for f in frames]
    sent = []
    for i in range(n):
        layout = layouts[i % len(layouts)]
        numbers = {p: int(rng.integers(0, 1 << f.bits - 1)) for p, f in enumerate(layout.frame.fields)}
        sent.append(layout.build(numbers))
    return sent


SENT = made(60)
BARE = (replace(PAIR[0], checksum="none", footer="0D 0A"), replace(PAIR[1], checksum="none"))


@pytest.mark.parametrize("frames", [PAIR, BARE], ids=["checksums", "none"])
@pytest.mark.parametrize("size", [1, 2, 3, 7, 8, 1000])
def test_any_cut_gives_the_same_frames(frames: tuple[Frame, ...], size: int) -> None:
    data = b"".join(made(60, frames)) + b"\xa5\x5a"
    kinds, bodies, counts = decoded([data[i : i + size] for i in range(0, len(data), size)], frames)
    assert kinds == [0, 1] * 30 and counts == (0, 0, 0)
    assert bodies == {0: b"".join(made(60, frames)[0::2]), 1: b"".join(made(60, frames)[1::2])}


@given(
    st.lists(st.tuples(st.integers(0, 60), st.binary(min_size=1, max_size=40)), max_size=5),
    st.lists(st.integers(0, 10**4), max_size=12),
    st.booleans(),
)
def test_garbage_anywhere_costs_at_most_the_frames_it_touches(
    garbage: list[tuple[int, bytes]], cuts: list[int], bare: bool
) -> None:
    frames = BARE if bare else PAIR
    pieces = made(60, frames)
    for at, noise in garbage:
        pieces.insert(at, noise)
    data = b"".join(pieces)
    whole = decoded([data], frames)
    assert decoded(cut(data, cuts), frames) == whole
    assert decoded([data[i : i + 1] for i in range(len(data))], frames) == whole
    assert len(whole[0]) >= 60 - 2 * len(garbage) - 1


@given(st.integers(1, 58), st.integers(0, 6), st.integers(1, 255))
def test_one_wrong_byte_costs_one_frame(which: int, where: int, change: int) -> None:
    spoilt = list(SENT)
    frame = bytearray(SENT[which])
    frame[where % len(frame)] ^= change
    spoilt[which] = bytes(frame)
    kinds, bodies, (bad, dropped, resyncs) = decoded([b"".join(spoilt)])
    assert len(kinds) == 59 and dropped == len(frame) and resyncs == 1 and bad <= 1
    assert bodies[0] + bodies[1] == b"".join(
        f for parity in (0, 1) for i, f in enumerate(SENT) if i % 2 == parity and i != which
    )


@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=6), st.booleans())
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int], bare: bool) -> None:
    frames = BARE if bare else PAIR
    assert decoded([data], frames) == decoded(cut(data, cuts), frames)


def test_a_sync_that_begins_another() -> None:
    frames = (
        Frame("AA", (Field("u16", "a"),), "short", checksum="sum8"),
        Frame("AA 01", (Field("u32", "b"),), "long", checksum="sum8"),
    )
    sent = made(40, frames)
    assert decoded([b"".join(sent)], frames)[0] == [0, 1] * 20


# the source ----------------------------------------------------------------------------------------------------------


def served(source: Binary, faults: FaultInjection = GOOD) -> tuple[Server, BinaryModel]:
    source.prepare()  # before the device is switched on, so that its counter is not past its first turn
    brain = BinaryModel(source)
    return Server(brain, line_at(), faults), brain


def truth(brain: BinaryModel, source: Binary, kind: int, turns: np.ndarray) -> np.ndarray:
    """What the channels of a frame held in these turns, in their units."""
    frame = source.frames[kind]
    places = [p for p, f in enumerate(frame.fields) if f.is_channel]
    rows = [
        [brain.number(frame, p, int(t)) * frame.fields[p].scale + frame.fields[p].offset for p in places] for t in turns
    ]
    return np.array(rows)


def test_frames_with_a_counter() -> None:
    source = Binary("", (PAIR[0],))
    server, brain = served(source, FaultInjection(lose=0.1, corrupt=0.03, duplicate=0.05, seed=4))
    with server, reading(replace(source, port=server.address)) as feed:
        wait_for(lambda: feed.count("motion") >= 300)
    check(source, feed)
    number = feed.data("timing")["counter"]
    assert (np.diff(number) > 0).all() and sum(feed.lost("motion").values()) == number[-1] - number[0] + 1 - len(number)
    assert np.array_equal(feed.data("motion"), truth(brain, source, 0, number))
    assert (
        feed.problems["lost frame"] > 10
        and feed.problems["bad checksum"] > 2
        and feed.problems["repeated frame or wrong time"] > 3
    )


def test_the_documented_sensor_time_in_a_frame_of_its_own() -> None:
    source = load(WITMOTION).nodes["sensor"].part
    assert isinstance(source, Binary)
    assert source.outputs == ("acceleration", "gyro", "angle", "timing")
    server, brain = served(source)
    with server, reading(replace(source, port=server.address)) as feed:
        wait_for(lambda: feed.count("gyro") >= 150)
    check(source, feed)
    assert brain.heard == bytes.fromhex("FFAA6988B5 FFAA020F00 FFAA030900")
    timing = feed.data("timing")
    device = timing["device"][np.searchsorted(timing["stamp"], feed.time("gyro"))]
    turns = np.round(device / NS * 100).astype(int)
    assert (np.diff(turns) == 1).all()
    for kind, name in ((1, "acceleration"), (2, "gyro"), (3, "angle")):
        assert np.array_equal(feed.data(name), truth(brain, source, kind, turns[: feed.count(name)])), name
        assert feed.lost(name) == {}
    assert np.array_equal(feed.time("gyro"), feed.time("acceleration")[: feed.count("gyro")]) or (
        np.abs(feed.time("gyro") - feed.time("acceleration")[: feed.count("gyro")]).max() < 100
    )


def test_the_sensors_bytes_mean_what_its_manual_says() -> None:
    """Frames as the WT901's manual builds them: 55, type, four int16, the sum of the ten bytes before."""
    source = load(WITMOTION).nodes["sensor"].part
    assert isinstance(source, Binary)
    layouts = source.layouts()
    stamp = bytes.fromhex("55 50 18 0B 15 0A 1E 0F 2C 01")
    accel = bytes.fromhex("55 51 00 08 00 F8 FF 7F 10 0A")
    found = FrameDecoder(layouts).feed(b"".join(f + bytes([sum(f) % 256]) for f in (stamp, accel)))
    assert found.kinds == [0, 1]
    assert (
        layouts[0].times_ns(layouts[0].table(bytes(found.frames[0])))[0]
        == ((10 * 60 + 30) * 60 + 15) * NS + 300_000_000
    )  # type: ignore[index]
    assert layouts[1].values(layouts[1].table(bytes(found.frames[1]))).tolist() == [[1.0, -1.0, 32767 / 2048]]


def test_loss_by_the_devices_time_and_a_device_switched_on_again() -> None:
    frame = Frame("7E", (Field("u32", role="time", unit="us"), Field("f32", "x")), "x", checksum="crc32", rate_hz=200.0)
    source = Binary("", (frame,))
    server, _ = served(source, FaultInjection(lose=0.1, reset_every_s=1.0, seed=3))
    with server, reading(replace(source, port=server.address)) as feed:
        wait_for(lambda: feed.problems["device restarted"] >= 2)
    check(source, feed)
    lost = feed.lost("x")
    assert sum(v > 0 for v in lost.values()) > 5 and sum(v < 0 for v in lost.values()) == 2
    late = np.abs(feed.data("timing")["arrival"] - feed.time("x"))
    assert np.median(late) < 0.3 * NS, (
        "each restart would leave the stamps a second off; single packets may be read late"
    )


def test_frames_without_clock_and_counter() -> None:
    source = Binary("", (replace(PAIR[1], rate_hz=None),))
    server, _ = served(source)
    with server, reading(replace(source, port=server.address)) as feed:
        wait_for(lambda: feed.count("battery") >= 30)
    check(source, feed)
    assert (feed.data("timing")["device"] == -1).all()


def test_bytes_of_another_device_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.frames.declaration_check.FIRST_FRAME_S", 0.3)
    server, _ = served(Binary("", (PAIR[0],)))
    wrong = Binary("", (replace(PAIR[0], checksum="xor8"),))
    again, _ = served(Binary("", (PAIR[0],)))
    with again, reading(replace(wrong, port=again.address)) as feed:
        wait_for(lambda: feed.error is not None)
    assert "frames[0]: checksum: sum8 with checksum_from: 0 fits" in str(feed.error)
    other = Binary("", (Frame("EE FF", (Field("u8", "a"),), "x", checksum="sum8"),))
    with server, reading(replace(other, port=server.address)) as feed:
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "expected ee ff and a right checksum; came 64 bytes: " in str(
        feed.error
    )


@pytest.mark.parametrize(
    ("kind", "start", "endian"),
    [("sum8", 2, "little"), ("xor8", 0, "little"), ("crc8", 1, "big"), ("crc16_modbus", 0, "little"), ("crc16_xmodem", 2, "big"),
     ("sum16", 2, "big"),
     ("crc32", 2, "little")],
)  # fmt: skip
@pytest.mark.parametrize("size", [1, 5, 1000])
def test_a_wrong_checksum_names_the_one_that_fits(kind: str, start: int, endian: str, size: int) -> None:
    true = replace(PAIR[0], checksum=kind, checksum_from=start, endian=endian)  # type: ignore[arg-type]
    bytes_of = CHECKSUMS[kind].size
    other = next(k for k in ("zero_sum8", "fletcher8", "crc32") if CHECKSUMS[k].size == bytes_of)
    declared = FrameLayout(replace(PAIR[0], checksum=other, checksum_from=0 if other != kind else 1))  # type: ignore[arg-type]
    data = b"\xa5\x5anoise" + b"".join(made(30, (true,)))
    decoder = FrameDecoder([declared])
    spoilt = [frame for i in range(0, len(data), size) for _, frame in decoder.feed(data[i : i + size]).spoilt]
    reported = fitting(spoilt, declared)
    assert f"checksum: {kind} with checksum_from: {start}" in reported and (
        bytes_of == 1 or f"{endian}-endian" in reported
    )


def test_frames_without_any_checksum_are_not_talked_into_one() -> None:
    rng, declared = np.random.default_rng(3), FrameLayout(PAIR[0])
    noise = [b"\xa5\x5a" + rng.bytes(declared.size - 2) for _ in range(200)]
    assert fitting(noise, declared) == "" and fitting(noise[:3], declared) == ""


GOOD_FRAME = {"name": "m", "sync": "55", "fields": [{"type": "u8", "name": "a"}]}


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([{**GOOD_FRAME, "sync": "5"}], "bytes in hex"),
        ([{**GOOD_FRAME, "sync": ""}], "at least one byte"),
        ([{**GOOD_FRAME, "sync": 0xAA55}], "sync is 43605; it must be bytes in hex and in quotes.*.0xAA55 is 43605"),
        ([{**GOOD_FRAME, "sync": 55}], "sync is 55; it must be bytes in hex and in quotes"),
        ([{**GOOD_FRAME, "fields": []}], "at least one field"),
        ([{**GOOD_FRAME, "fields": [{"type": "u8"}]}], "at least one of which has a named data field"),
        ([{**GOOD_FRAME, "fields": [{"type": "u9", "name": "a"}]}], "type"),
        ([{**GOOD_FRAME, "name": "1 m"}], "it names an output"),
        ([{**GOOD_FRAME, "name": "timing"}], "it names an output"),
        ([GOOD_FRAME, {**GOOD_FRAME, "sync": "56"}], "frames.name is 'm'; it must be another one"),
        ([GOOD_FRAME, {**GOOD_FRAME, "name": "n"}], "frames.sync is '55'"),
        ([{**GOOD_FRAME, "fields": [{"type": "u8", "role": "counter"}, {"type": "u8", "name": "a"}]}], "only clock"),
        (
            [{**GOOD_FRAME, "fields": [{"type": "i8", "role": "counter"}, {"type": "u8", "name": "a"}]}],
            "of type u8 to u32",
        ),
        (
            [{**GOOD_FRAME, "fields": [{"type": "u8", "role": "time", "unit": "h2"}, {"type": "u8", "name": "a"}]}],
            "a unit out of",
        ),
        ([{**GOOD_FRAME, "checksum": "crc7"}], "checksum"),
        ([{**GOOD_FRAME, "checksum": "sum8", "checksum_from": 2}], "below 2"),
        ([{**GOOD_FRAME, "footers": "0D"}], "footers"),
        (
            [{**GOOD_FRAME, "fields": [{"type": "u12", "name": "a"}]}],
            "12 bits'; it must be whole bytes; add a field of 4",
        ),
        (
            [{**GOOD_FRAME, "fields": [{"type": "u4"}, {"type": "f32", "name": "a"}, {"type": "u4"}]}],
            "beginning of a byte",
        ),
        ([{**GOOD_FRAME, "samples": 2}], "rate_hz.* given, where a frame holds several samples"),
        (
            [
                {
                    **GOOD_FRAME,
                    "samples": 2,
                    "rate_hz": 5,
                    "fields": [
                        {"type": "u8", "name": "a"},
                        {"type": "u8", "role": "counter"},
                        {"type": "u8", "name": "b"},
                    ],
                }
            ],
            "counter'; it must be before or behind the samples",
        ),
    ],
)
def test_what_cannot_be_declared(frames: list[dict[str, object]], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Binary, {"port": "/dev/ttyUSB0", "frames": frames}).specs()


def test_no_port_at_all() -> None:
    with pytest.raises(DeviceError, match="does not exist"):
        Binary("/dev/ttyNOTTHERE", PAIR).read(Kept())
