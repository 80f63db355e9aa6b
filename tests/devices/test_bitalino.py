"""BITalino: frames written out by hand, cuts, garbage, damage; the source against the simulated device; a counter that runs over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.bitalino import protocol as protocol
from kinegraph.devices.bitalino.protocol import BitalinoDecoder, BitalinoFrames, crc_of, frame, size_of, widths
from kinegraph.devices.bitalino.simulator import BitalinoModel
from kinegraph.devices.bitalino.source import Bitalino, BitalinoChannel
from kinegraph.devices.clocks.short_counter import ShortCounter
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from tests.support.device_feed import Kept, check, cut, reading, wait_for

RNG = np.random.default_rng(5)
COUNTS = [[int(RNG.integers(0, 1 << bits)) for bits in widths(6)] for _ in range(80)]
FRAMES = [frame(i + 9, row, (i % 2, i // 2 % 2, 0, 1)) for i, row in enumerate(COUNTS)]


def decoded(pieces: list[bytes], channels: int = 6) -> tuple[list[list[int]], int, int]:
    """(sequence and counts of every frame, bytes dropped, resyncs)."""
    decoder = BitalinoDecoder(channels)
    found: list[BitalinoFrames] = [decoder.feed(piece) for piece in pieces]
    rows = [[int(s), *c] for f in found for s, c in zip(f.sequence, f.counts.tolist(), strict=True)]
    return rows, sum(f.dropped for f in found), sum(f.resyncs for f in found)


WANTED = [[(i + 9) % 16, *row] for i, row in enumerate(COUNTS)]


# the decoder ---------------------------------------------------------------------------------------------------------


def slow_crc(data: bytes) -> int:
    """Long division by x^4 + x + 1, bit by bit, as the data sheet has it."""
    remainder = 0
    for byte in data:
        for bit in f"{byte:08b}":
            remainder = remainder << 1 | int(bit)
            if remainder & 0b10000:
                remainder ^= 0b10011
    return remainder


def test_a_frame_written_out_by_hand() -> None:
    """Sequence 10, I2 and O2 set, A1 = 0x2AB, A2 = 0x155, A3 = 1, A4 = 0x3FE, A5 = 0x2A, A6 = 0x15."""
    bits = (
        "1010" + "{crc:04b}" + "0101" + "1010101011" + "0101010101" + "0000000001" + "1111111110" + "101010" + "010101"
    )
    zero = int(bits.format(crc=0), 2).to_bytes(8, "little")
    data = int(bits.format(crc=slow_crc(zero)), 2).to_bytes(8, "little")
    assert frame(10, [0x2AB, 0x155, 1, 0x3FE, 0x2A, 0x15], (0, 1, 0, 1)) == data and crc_of(data) == slow_crc(zero)
    (found,) = (protocol.unpack(data, 6),)
    assert found.sequence.tolist() == [10] and found.digital.tolist() == [[0, 1, 0, 1]]
    assert found.counts.tolist() == [[0x2AB, 0x155, 1, 0x3FE, 0x2A, 0x15]]


def test_sizes_and_commands() -> None:
    assert [size_of(n) for n in range(1, 7)] == [3, 4, 6, 7, 8, 8]
    assert [protocol.rate_command(r).hex() for r in (1, 10, 100, 1000)] == ["03", "43", "83", "c3"]
    assert protocol.start_command([1, 3, 6]) == bytes([0b10010101])


@pytest.mark.parametrize(("counts", "volts"), [(527, 3.4), (590, 3.8)])
def test_the_batterys_alarm_is_where_the_firmware_has_it(counts: int, volts: float) -> None:
    """Its least and its greatest threshold, in counts and in volts, are those of the maker's firmware and API."""
    answer = protocol.state([0] * 6, counts / 1024 * 2 * protocol.VCC_V, (0, 0, 0, 0), "BITalino_v5.2")
    assert int.from_bytes(answer[12:14], "little") == counts
    assert protocol.battery_v(answer, 17) == pytest.approx(volts, abs=0.005)


@pytest.mark.parametrize("channels", range(1, 7))
@pytest.mark.parametrize("size", [1, 3, 8, 50, 10**6])
def test_any_cut_gives_the_same_frames(channels: int, size: int) -> None:
    rows = [row[:channels] for row in COUNTS]
    data = b"".join(frame(i, row) for i, row in enumerate(rows))
    found, dropped, resyncs = decoded([data[i : i + size] for i in range(0, len(data), size)], channels)
    assert found == [[i % 16, *row] for i, row in enumerate(rows)] and (dropped, resyncs) == (0, 0)


@given(
    st.lists(st.tuples(st.integers(0, 80), st.binary(min_size=1, max_size=60)), max_size=5),
    st.lists(st.integers(0, 2000), max_size=9),
)
def test_garbage_between_frames_is_passed_over(garbage: list[tuple[int, bytes]], cuts: list[int]) -> None:
    pieces = list(FRAMES)
    for at, noise in garbage:
        pieces.insert(at, noise)
    data = b"".join(pieces)
    whole = decoded([data])
    assert decoded([data[i : i + 1] for i in range(len(data))]) == whole
    assert decoded(cut(data, cuts)) == whole
    missing = [row for row in WANTED if row not in whole[0]]
    assert len(missing) <= 7 * len(garbage)  # a piece between two others is believed only after three in a row


@given(st.integers(4, 70), st.integers(0, 7), st.integers(1, 255))
def test_one_wrong_byte_costs_one_frame(which: int, where: int, change: int) -> None:
    spoilt = bytearray(b"".join(FRAMES))
    spoilt[8 * which + where] ^= change
    found, _, _ = decoded([bytes(spoilt)])
    assert [row for row in WANTED if row not in found] in ([], [WANTED[which]])
    assert len(found) >= 79


@given(st.integers(4, 70), st.integers(1, 7))
def test_lost_bytes_cost_the_frame_they_belong_to(which: int, count: int) -> None:
    data = b"".join(FRAMES)
    found, _, _ = decoded([data[: 8 * which] + data[8 * which + count :]])
    missing = [row for row in WANTED if row not in found]
    assert len(missing) <= 2 and WANTED[which] in missing


@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=8), st.integers(1, 6))
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int], channels: int) -> None:
    whole = decoded([data], channels)
    assert decoded(cut(data, cuts), channels) == whole
    assert size_of(channels) * len(whole[0]) + whole[1] <= len(data)


def test_it_holds_little_back() -> None:
    decoder = BitalinoDecoder(6)
    decoder.feed(b"".join(FRAMES))
    for _ in range(50):
        decoder.feed(RNG.integers(0, 256, 1000, dtype=np.uint8).tobytes())
        assert len(decoder._buffer) < 8 * 8


# the counter ---------------------------------------------------------------------------------------------------------


def test_bursts_and_stalls_are_no_loss() -> None:
    """1000 frames a second that come in bursts of 30 to 60 ms, and once after 300 ms."""
    counter, sent, now = ShortCounter(4, 1000), 0, 0.0
    for turn in range(300):
        now += 0.3 if turn == 150 else float(RNG.uniform(0.03, 0.06))
        due = int(now * 1000)
        packets = counter.take(np.arange(sent, due) % 16, NS + round(now * NS))
        assert not packets.lost.any()
        sent = due
    assert packets.number[-1] == sent - 1


@pytest.mark.parametrize("missing", [5, 16, 100, 1000])
def test_whole_turns_that_are_missing_show_within_seconds(missing: int) -> None:
    counter, lost, at = ShortCounter(4, 1000), [], []
    for number in range(0, 20_000, 10):
        shift = missing if number >= 8000 else 0
        arrival = NS + (number + shift + 10) * 1_000_000 + int(RNG.exponential(2e6))
        packets = counter.take((np.arange(number, number + 10) + shift) % 16, arrival)
        lost += [int(n) for n in packets.lost if n]
        at += [number + i for i, n in enumerate(packets.lost) if n]
        assert (np.diff(packets.stamp) > 0).all()
    assert sum(lost) == missing and at[0] >= 8000 and at[-1] <= 11_000
    assert packets.number[-1] == 19_999 + missing


# the source ----------------------------------------------------------------------------------------------------------

CHANNELS = (BitalinoChannel("A3", "ecg", "heart"), BitalinoChannel("A1", "emg"), BitalinoChannel("A2", "eda"))


def read(brain: BitalinoModel, n: int, faults: FaultInjection = GOOD, address: str = "", **given: object) -> Kept:
    with Server(brain, line_at(address, "rfcommSIM"), faults) as server:
        source = replace(Bitalino(server.address, CHANNELS), **given)  # type: ignore[arg-type]
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("analog") >= n, 60)
    if feed.chunks:
        check(source, feed)
    return feed


def truth(brain: BitalinoModel, feed: Kept) -> np.ndarray:
    counts = np.array([brain.counts(int(i)) for i in feed.data("timing")["counter"]]) / 1024
    return np.column_stack(
        [(counts[:, 0] - 0.5) * 3.3e6 / 1009, counts[:, 1] * 3.3 / 0.132, (counts[:, 2] - 0.5) * 3.3e6 / 1100]
    )


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
@pytest.mark.parametrize("rate_hz", [100, 1000])
def test_what_the_device_measures_arrives(address: str, rate_hz: int) -> None:
    brain = BitalinoModel(("emg", "eda", "ecg", "volt", "volt", "volt"), seed=3)
    feed = read(brain, 2 * rate_hz, address=address, rate_hz=rate_hz)
    assert feed.error is None and not feed.problems and feed.lost("analog") == {}
    np.testing.assert_allclose(feed.data("analog"), truth(brain, feed), rtol=1e-12, atol=1e-9)
    number = feed.data("timing")["counter"]
    assert np.array_equal(feed.data("digital"), [brain.digital(int(i)) for i in number])
    assert feed.identity["firmware"] == "BITalino_v5.2" and feed.identity["battery_v"] == pytest.approx(3.9, abs=0.01)
    assert np.median(np.diff(feed.time("analog"))) == pytest.approx(NS / rate_hz, rel=0.01)


def test_channels_are_in_the_order_of_the_inputs() -> None:
    spec = Bitalino("/dev/rfcomm0", CHANNELS).specs()["analog"]
    assert spec.channels == ("A1", "A2", "heart") and spec.units == ("uV", "uS", "uV")


def test_lost_and_damaged_frames_are_counted_and_nothing_is_invented() -> None:
    brain = BitalinoModel(("emg", "eda", "ecg", "volt", "volt", "volt"), seed=4)
    feed = read(brain, 3000, FaultInjection(lose=0.03, corrupt=0.02, seed=2))
    assert feed.error is None
    number = feed.data("timing")["counter"]
    assert (np.diff(number) > 0).all()
    assert (
        sum(feed.lost("analog").values())
        == number[-1] - number[0] + 1 - len(number)
        == feed.problems["lost frame"]
        > 50
    )
    wrong = np.abs(feed.data("analog") - truth(brain, feed)).max(axis=1) > 1e-6
    assert wrong.mean() < 0.005, "a CRC of four bits lets one damaged frame in 16 pass"


def test_a_stall_is_no_loss_and_a_short_counters_restart_looks_like_one() -> None:
    assert not read(BitalinoModel(), 2500, FaultInjection(stall_every_s=1.0, stall_s=0.3)).problems
    feed = read(BitalinoModel(), 2500, FaultInjection(reset_every_s=0.905))
    assert feed.error is None and all(0 < n < 16 for n in feed.lost("analog").values())


@pytest.mark.parametrize(
    ("answer", "message"),
    [(b"", "came nothing"), (b"hello\n", "expected 'BITalino_v...'"), (b"BIT", "came 3 bytes: 42 49 54")],
)
def test_a_wrong_answer_is_told(answer: bytes, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Other(BitalinoModel):
        def _obey(self, command: int) -> bytes:
            return answer if command == 0x07 else super()._obey(command)

    monkeypatch.setattr("kinegraph.devices.bitalino.source.ANSWER_S", 0.4)
    feed = read(Other(), 1)
    assert isinstance(feed.error, DeviceError) and message in str(feed.error)


def test_a_device_that_falls_silent_is_opened_again() -> None:
    class Silent(BitalinoModel):
        def say(self, seconds: float) -> list[bytes]:
            return super().say(seconds) if self._said < 100 else []

    feed = read(Silent(), 10**9)
    assert isinstance(feed.error, DeviceError) and "no frame" in str(feed.error)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"channels": []}, "one to six different inputs"),
        ({"channels": [{"input": "A1"}, {"input": "A1"}]}, "one to six different inputs"),
        ({"channels": [{"input": "A1", "name": "x"}, {"input": "A2", "name": "x"}]}, "with different names"),
        ({"channels": [{"input": "A7"}]}, "input"),
        ({"channels": [{"input": "A1", "sensor": "emgg"}]}, "sensor"),
        ({"channels": [{"input": "A1"}], "rate_hz": 500}, "rate_hz"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Bitalino, {"port": "x", **given}).specs()


def test_the_simulated_device_stands_in_for_the_real_one() -> None:
    source = Bitalino("/dev/rfcomm0", CHANNELS, 100)
    with source.simulated() as there:
        assert replace(there, port="/dev/rfcomm0") == source
        with reading(there) as feed:
            wait_for(lambda: feed.count("analog") >= 20)
    assert np.ptp(feed.data("analog")[:, 1]) < 3 and feed.data("analog")[:, 1].mean() == pytest.approx(5, abs=1.5)
