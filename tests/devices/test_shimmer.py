"""Shimmer3: packets written out by hand, cuts, garbage, damage, news between packets; units; the source against the simulated device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.devices.shimmer import protocol as protocol
from kinegraph.devices.shimmer import units as units
from kinegraph.devices.shimmer.protocol import TICKS, ShimmerDecoder, ShimmerPackets, answer_in, columns, packet
from kinegraph.devices.shimmer.simulator import ShimmerModel
from kinegraph.devices.shimmer.source import Shimmer
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from tests.support.device_feed import Kept, check, cut, reading, wait_for

CHANNELS = (0, 1, 2, 10, 11, 12, 29, 30, 31)
NAMES = ["ax", "ay", "az", "gx", "gy", "gz", "exg1", "exg2"]
DIVIDER = 64
RNG = np.random.default_rng(11)
COUNTS = [
    [*map(int, RNG.integers(-32768, 32768, 6)), 128, *map(int, RNG.integers(-(2**23), 2**23, 2))] for _ in range(80)
]
BEGIN = TICKS - 20 * DIVIDER
"""The device's time runs over on the way."""
PACKETS = [packet(BEGIN + i * DIVIDER, CHANNELS, row) for i, row in enumerate(COUNTS)]
WANTED = [[(BEGIN + i * DIVIDER) % TICKS, *row[:6], *row[7:]] for i, row in enumerate(COUNTS)]


def decoded(pieces: list[bytes]) -> tuple[list[list[int]], int, int, int]:
    """(ticks and counts of every packet, bytes dropped, resyncs, repeated)."""
    decoder = ShimmerDecoder(CHANNELS, DIVIDER)
    found: list[ShimmerPackets] = [decoder.feed(piece) for piece in pieces]
    rows = [[int(t), *map(int, c)] for f in found for t, c in zip(f.ticks, columns(f, CHANNELS, NAMES), strict=True)]
    return rows, sum(f.dropped for f in found), sum(f.resyncs for f in found), sum(f.repeated for f in found)


# the decoder ---------------------------------------------------------------------------------------------------------


def test_a_packet_written_out_by_hand() -> None:
    data = bytes.fromhex("00 563412 FFFF 0180 FF7F FFFE 8000 7FFF 80 FFFFFE 7FFFFF")
    decoder = ShimmerDecoder(CHANNELS, DIVIDER)
    assert decoder.size == len(data)
    later = [bytes([0]) + (0x123456 + i * DIVIDER).to_bytes(3, "little") + data[4:] for i in (1, 2)]
    found = decoder.feed(b"\xff" + data + later[0] + later[1])
    assert found.ticks.tolist() == [0x123456, 0x123456 + DIVIDER, 0x123456 + 2 * DIVIDER]
    assert columns(found, CHANNELS, NAMES)[0].tolist() == [-1, -32767, 32767, -2, -32768, 32767, -2, 2**23 - 1]
    assert packet(0x123456, CHANNELS, [-1, -32767, 32767, -2, -32768, 32767, 128, -2, 2**23 - 1]) == data


@pytest.mark.parametrize("size", [1, 3, 23, 50, 10**6])
def test_any_cut_gives_the_same_packets(size: int) -> None:
    data = b"".join(PACKETS)
    assert decoded([data[i : i + size] for i in range(0, len(data), size)]) == (WANTED, 0, 0, 0)


NEWS = st.sampled_from([b"\xff", b"\x8a\x71\x10", b"\xff\x8a\x71\x30", b"\xff\x8a\x94\x12\x0b\x80"])


@given(st.lists(st.tuples(st.integers(0, 80), NEWS), max_size=6), st.lists(st.integers(0, 2000), max_size=9))
def test_answers_between_packets_are_told_apart(news: list[tuple[int, bytes]], cuts: list[int]) -> None:
    pieces = list(PACKETS)
    for at, one in news:
        pieces.insert(at, one)
    assert decoded(cut(b"".join(pieces), cuts)) == (WANTED, 0, 0, 0)


def test_the_battery_is_told_while_it_measures() -> None:
    decoder = ShimmerDecoder(CHANNELS, DIVIDER)
    found = [decoder.feed(b"".join(PACKETS[:5]) + b"\xff\x8a\x94\x12"), decoder.feed(b"\x0b\x80" + PACKETS[5])]
    assert [len(f) for f in found] == [5, 1] and found[1].battery == [b"\x12\x0b\x80"]
    assert protocol.battery_v(found[1].battery[0]) == pytest.approx(0x0B12 / 4095 * 3 * 1.988)


@settings(max_examples=25)
@given(
    st.lists(st.tuples(st.integers(0, 80), st.binary(min_size=1, max_size=60)), max_size=5),
    st.lists(st.integers(0, 2500), max_size=9),
)
def test_garbage_between_packets_is_passed_over(garbage: list[tuple[int, bytes]], cuts: list[int]) -> None:
    pieces = list(PACKETS)
    for at, noise in garbage:
        pieces.insert(at, noise)
    data = b"".join(pieces)
    whole = decoded([data])
    assert decoded([data[i : i + 1] for i in range(len(data))]) == whole
    assert decoded(cut(data, cuts)) == whole
    missing = [row for row in WANTED if row not in whole[0]]
    assert len(missing) <= 4 * len(garbage)  # a packet or two alone between pieces of garbage are not believed
    if len(garbage) == 1 and 0 < garbage[0][0] < 79:
        assert len(missing) <= 1, "found again within one packet"


@given(st.integers(3, 70), st.integers(0, 22), st.integers(1, 255))
def test_one_wrong_byte_costs_at_most_one_packet(which: int, where: int, change: int) -> None:
    """A changed value passes, as nothing tells it; a changed head costs its packet."""
    spoilt = bytearray(b"".join(PACKETS))
    spoilt[len(PACKETS[0]) * which + where] ^= change
    found, _, _, _ = decoded([bytes(spoilt)])
    assert [row for row in WANTED if row not in found] in ([], [WANTED[which]])


@given(st.integers(3, 70), st.integers(1, 22))
def test_lost_bytes_cost_the_packet_they_belong_to(which: int, count: int) -> None:
    data, size = b"".join(PACKETS), len(PACKETS[0])
    found, _, _, _ = decoded([data[: size * which] + data[size * which + count :]])
    missing = [row for row in WANTED if row not in found]
    assert len(missing) <= 2 and WANTED[which] in missing


@given(st.lists(st.integers(0, 79), max_size=20), st.lists(st.integers(0, 79), max_size=5))
def test_lost_and_repeated_packets(lost: list[int], twice: list[int]) -> None:
    kept = [i for i in range(80) if i not in lost or i > 76]
    sent = b"".join(PACKETS[i] * (1 + (i in twice)) for i in kept)
    found, dropped, resyncs, repeated = decoded([sent])
    alone = {i for i in kept if i - 1 not in kept and i + 1 not in kept}
    rows = [row for row in (WANTED[i] for i in kept) if row not in found]
    assert all(WANTED.index(row) in alone or len(kept) < 6 or WANTED.index(row) in kept[:3] for row in rows)
    if not lost and min(twice, default=9) > 2:
        assert (dropped, resyncs) == (0, 0) and repeated <= len(set(twice))


@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=8))
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int]) -> None:
    whole = decoded([data])
    assert decoded(cut(data, cuts)) == whole
    assert len(PACKETS[0]) * len(whole[0]) + whole[1] <= len(data)


def test_it_holds_little_back() -> None:
    decoder = ShimmerDecoder(CHANNELS, DIVIDER)
    decoder.feed(b"".join(PACKETS))
    for _ in range(50):
        decoder.feed(RNG.integers(0, 256, 1000, dtype=np.uint8).tobytes())
        assert len(decoder._buffer) < 6 * decoder.size


@given(st.binary(max_size=60))
def test_answers_are_found_whole_or_not_at_all(data: bytes) -> None:
    for code, size in ((0x2F, 6), (0x7A, 0), (0x02, -1), (0x94, 3), (0xFF, 0)):
        answer_in(data, code, size)
    inquiry = b"\xff\x8a\x71\x00\x02" + bytes.fromhex("4000 08000100 03 01 000102")
    assert answer_in(inquiry, 0x02, -1) == inquiry[5:]
    assert all(answer_in(inquiry[:i], 0x02, -1) is None for i in range(len(inquiry)))
    assert protocol.inquiry(inquiry[5:]) == protocol.Inquiry(64, 2, 1, (0, 1, 2))
    assert answer_in(b"\xff\x7a\x03abc" + data, 0x7A, 0) == b"\x03abc"


# units ---------------------------------------------------------------------------------------------------------------


def test_calibration_there_and_back() -> None:
    turned = np.array([[0.02, -1, 0], [-0.99, 0.03, 0], [0, 0.01, -1]])
    known = units.ShimmerCalibration(np.array([2000.0, 2100.0, 2050.0]), np.array([82.0, 84.0, 83.0]), turned)
    again = units.calibration(units.stored({"acceleration": known}), "acceleration")
    assert again.own
    values = RNG.normal(size=(5, 3))
    np.testing.assert_allclose(again.apply(known.counts(values)), values, atol=1e-12)
    by_hand = np.linalg.inv(turned) @ ((np.array([2100.0, 2000.0, 1950.0]) - known.offset) / known.sensitivity)
    np.testing.assert_allclose(again.apply(np.array([[2100.0, 2000.0, 1950.0]]))[0], by_hand)


def test_without_a_calibration_for_the_range_the_data_sheet_counts() -> None:
    nothing = units.stored({})
    assert not units.calibration(nothing, "angular_velocity").own
    at_500 = units.stored({"angular_velocity": replace(units.nominal("angular_velocity", gyro_range=1), own=True)})
    assert units.calibration(at_500, "angular_velocity", gyro_range=1).own
    other = units.calibration(at_500, "angular_velocity", gyro_range=3)
    assert not other.own and other.sensitivity[0] == pytest.approx(16.4 * 180 / np.pi)


@pytest.mark.parametrize(
    ("board", "newer"),
    [((47, 3, 0), True), ((47, 1, 0), False), ((31, 5, 9), False), ((31, 6, 0), True), ((37, 1, 171), True),
     ((255, 255, 255), False), ((14, 9, 0), False)],
)  # fmt: skip
def test_the_board_tells_the_chips(board: tuple[int, int, int], newer: bool) -> None:
    assert units.chips_of(bytes(board)) == (units.NEWER if newer else units.OLDER)


def test_the_sensors_own_rates_are_not_below_the_packets() -> None:
    assert [units.gyro_divider(hz) for hz in (512, 204.8, 51.2, 1)] == [14, 38, 155, 255]
    assert [units.OLDER.wide_rate(hz) for hz in (1, 51.2, 204.8, 512)] == [1, 5, 7, 9]
    assert [units.NEWER.wide_rate(hz) for hz in (1, 51.2, 204.8, 512)] == [1, 4, 6, 7]


def test_exg_registers_and_gain() -> None:
    assert [r[0] for r in units.registers("emg", 512)] == [3, 3] and units.registers("ecg", 125)[0][0] == 0
    np.testing.assert_allclose(units.exg_uv("emg", 2), 2.42 / 12 / (2**23 - 1) * 1e6)
    np.testing.assert_allclose(units.exg_uv("ecg", 4), 2.42 / 4 / (2**23 - 1) * 1e6)


# the source ----------------------------------------------------------------------------------------------------------


def read(brain: ShimmerModel, n: int, faults: FaultInjection = GOOD, address: str = "", **given: object) -> Kept:
    with Server(brain, line_at(address, "rfcommSHIM"), faults) as server:
        source = replace(Shimmer(server.address, rate_hz=512), **given)  # type: ignore[arg-type]
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("timing") >= n, 60)
    if feed.chunks:
        check(source, feed)
    return feed


def truth(brain: ShimmerModel, feed: Kept) -> tuple[np.ndarray, np.ndarray]:
    """(ax..gz, emg) of the packets that came."""
    number = np.round((feed.data("timing")["device"] * 32768 / NS - 1000) / brain.divider).astype(int)
    counts = brain.counts(0, number[-1] + 1)[number]
    acceleration, gyro = brain._known("acceleration"), brain._known("angular_velocity")
    motion = np.hstack([acceleration.apply(counts[:, :3]), gyro.apply(counts[:, 3:6])])
    return motion, counts[:, 7:] * 2.42e6 / 12 / (2**23 - 1)


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
def test_what_the_device_measures_arrives(address: str) -> None:
    brain = ShimmerModel(seed=3)
    feed = read(brain, 600, address=address, sensors=("angular_velocity", "acceleration", "emg"))
    assert feed.error is None and not feed.problems and feed.lost("motion") == {} == feed.lost("exg")
    motion, emg = truth(brain, feed)
    np.testing.assert_allclose(feed.data("motion"), motion, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(feed.data("exg"), emg, rtol=1e-12)
    assert np.median(np.diff(feed.time("motion"))) == pytest.approx(NS / 512, rel=0.01)
    true = brain.limb.measure(np.arange(100))
    np.testing.assert_allclose(feed.data("motion")[:100, :3], true["acceleration"], atol=0.01)
    assert feed.identity["firmware"] == "LogAndStream 0.16.0" and feed.identity["name"] == "Shimmer3-5A1E"
    assert feed.identity["battery_v"] == pytest.approx(3.95, abs=0.01)


@pytest.mark.parametrize(("board", "code"), [((47, 5, 0), 1), ((37, 1, 0), 3)])
def test_ranges_and_ecg(board: tuple[int, int, int], code: int) -> None:
    """The wide-range accelerometer's 16 g has another code on later boards."""
    brain = ShimmerModel(seed=5, board=board)
    feed = read(
        brain, 60, sensors=("wide_acceleration", "angular_velocity", "ecg"), wide_range_g=16, gyro_range_dps=2000
    )
    assert feed.error is None and (brain.wide_range, brain.gyro_range) == (code, 3)
    assert feed.identity["board"] == "SR{}-{}-{}".format(*board)
    assert brain.gyro_hz >= 512 and brain.wide_hz >= 512, "set to measure as often as the packets come"
    true = brain.limb.measure(np.arange(60))
    np.testing.assert_allclose(feed.data("motion")[:60, 3:], true["angular_velocity"], atol=0.002)
    np.testing.assert_allclose(feed.data("motion")[:60, :3], true["acceleration"], atol=0.01)
    assert feed.data("exg").shape[1] == 3 and brain.registers == list(units.registers("ecg", 512))
    assert Shimmer("x", ("ecg",)).outputs == ("exg", "timing")


def test_lost_packets_are_counted_and_nothing_is_invented() -> None:
    brain = ShimmerModel(seed=4)
    wrong = FaultInjection(lose=0.03, duplicate=0.02, seed=2)
    feed = read(brain, 1000, wrong, sensors=("acceleration", "angular_velocity", "emg"))
    assert feed.error is None and feed.problems["repeated packet"] > 5
    number = np.round((feed.data("timing")["device"] * 32768 / NS - 1000) / brain.divider).astype(int)
    assert (np.diff(number) > 0).all()
    lost = sum(feed.lost("motion").values())
    assert lost == sum(feed.lost("exg").values()) == feed.problems["lost packet"] > 10
    assert lost == number[-1] - number[0] + 1 - len(number)
    np.testing.assert_allclose(feed.data("motion"), truth(brain, feed)[0], rtol=1e-12, atol=1e-12)


def test_damage_costs_packets_or_passes_unseen() -> None:
    feed = read(ShimmerModel(), 1000, FaultInjection(corrupt=0.08, seed=2))
    assert feed.error is None and feed.problems["resync"] > 5 and feed.problems["lost packet"] > 5


def test_a_stall_is_no_loss_and_a_restart_is_told() -> None:
    assert not read(ShimmerModel(), 700, FaultInjection(stall_every_s=1.0, stall_s=0.3)).problems
    feed = read(ShimmerModel(), 800, FaultInjection(reset_every_s=1.0))
    assert feed.error is None and feed.problems["device restarted"] >= 1 and -1 in feed.lost("motion").values()


def test_unplugged_in_mid_packet() -> None:
    with Server(ShimmerModel(), line_at("", "rfcommSHIM")) as server:
        for _ in range(2):
            with reading(Shimmer(server.address, rate_hz=512)) as feed:
                wait_for(lambda feed=feed: feed.count("motion") >= 50)
                server.unplug()
                wait_for(lambda feed=feed: feed.error is not None)
            assert isinstance(feed.error, DeviceError) and "gone" in str(feed.error)
            server.plug()


@pytest.mark.parametrize(
    ("code", "answer", "message"),
    [
        (0x2E, b"", "expected 2F after command 2E .*came nothing"),
        (0x2E, b"\xff\x2f\x02\x00\x00\x00\x10\x00", "expected the firmware LogAndStream"),
        (0x3F, b"\xff\x25\x0a", "it is a Shimmer3R"),
        (0x01, b"\xff\x02\x40\x00\x08\x00\x01\x00\x02\x01\x00\x03", "offers 0x03, ax every 64"),
    ],
)
def test_a_wrong_device_is_told(code: int, answer: bytes, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Other(ShimmerModel):
        def _obey(self, command: int, data: bytes) -> bytes:
            return answer if command == code else super()._obey(command, data)

    if not answer:
        monkeypatch.setattr("kinegraph.devices.shimmer.commands.ANSWER_S", 0.1)
    feed = read(Other(), 1)
    assert isinstance(feed.error, DeviceError)
    with pytest.raises(DeviceError, match=message):
        raise feed.error


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sensors": []}, "some of acceleration"),
        ({"sensors": ["emg", "ecg"]}, "one of emg, ecg"),
        ({"sensors": ["gyro"]}, "sensors"),
        ({"rate_hz": 2000}, "rate_hz"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Shimmer, {"port": "x", **given}).specs()


def test_the_simulated_device_stands_in_for_the_real_one() -> None:
    source = Shimmer("/dev/rfcomm0")
    with source.simulated() as there:
        assert replace(there, port="/dev/rfcomm0") == source
        with reading(there) as feed:
            wait_for(lambda: feed.count("motion") >= 20)
    assert feed.error is None
