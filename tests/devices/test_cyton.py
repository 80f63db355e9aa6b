"""OpenBCI Cyton and Daisy: bytes cut anywhere, garbage, commands; the source against the simulated board; the board's faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.cyton.protocol import ChannelSetting, CytonDecoder, acceleration, packet, switch, uv_per_count
from kinegraph.devices.cyton.simulator import CytonModel
from kinegraph.devices.cyton.simulator import SimulatedCyton as Simulated
from kinegraph.devices.cyton.source import Cyton
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from tests.support.device_feed import Kept, check, cut, reading, wait_for

RNG = np.random.default_rng(7)
COUNTS = RNG.integers(-(2**23), 2**23, (300, 8))
AUX = [bytes(RNG.integers(0, 256, 6, dtype=np.uint8)) for _ in range(300)]
PACKETS = [packet(i + 200, COUNTS[i], AUX[i], 0xC0 + i % 7) for i in range(300)]
STREAM = b"".join(PACKETS)


def decoded(pieces: list[bytes]) -> tuple[np.ndarray, np.ndarray, int]:
    """(counters, counts, bytes dropped) of all pieces."""
    decoder = CytonDecoder()
    frames = [decoder.feed(piece) for piece in pieces]
    return (
        np.concatenate([f.counter for f in frames]),
        np.concatenate([f.counts for f in frames]),
        sum(f.dropped for f in frames),
    )


# the decoder ---------------------------------------------------------------------------------------------------------


def test_a_packet_of_the_documentation() -> None:
    """The example numbers of the data format: three-byte two's complement, and the scale in use at gain 24."""
    body = (
        bytes([0xA0, 5]) + bytes.fromhex("7fffff 800000 000001 ffffff 000000 123456 edcba9 00ff00") + bytes(6) + b"\xc0"
    )
    frames = CytonDecoder().feed(body + packet(6, np.zeros(8)))
    assert frames.counter.tolist() == [5, 6]
    assert frames.counts[0].tolist() == [8388607, -8388608, 1, -1, 0, 0x123456, -0x123457, 0xFF00]
    assert uv_per_count(24) == pytest.approx(0.02235174, abs=1e-8)
    assert body == packet(5, frames.counts[0])


@pytest.mark.parametrize("size", [1, 2, 7, 32, 33, 34, 66, 1000, 10**6])
def test_any_cut_gives_the_same_packets(size: int) -> None:
    counter, counts, dropped = decoded([STREAM[i : i + size] for i in range(0, len(STREAM), size)])
    assert dropped == 0
    assert counter.tolist() == [(i + 200) % 256 for i in range(300)]
    assert np.array_equal(counts, COUNTS)


@given(
    st.lists(st.tuples(st.integers(0, 60), st.binary(min_size=1, max_size=80)), max_size=6),
    st.lists(st.integers(0, 10**4), max_size=12),
)
def test_garbage_anywhere_costs_at_most_the_packet_it_hits(garbage: list[tuple[int, bytes]], cuts: list[int]) -> None:
    pieces = list(PACKETS[:60])
    for at, noise in garbage:
        pieces.insert(at, noise)
    data = b"".join(pieces)
    whole, byte_by_byte, pieced = (
        decoded([data]),
        decoded([data[i : i + 1] for i in range(len(data))]),
        decoded(cut(data, cuts)),
    )
    for other in (byte_by_byte, pieced):
        assert other[0].tolist() == whole[0].tolist() and np.array_equal(other[1], whole[1]) and other[2] == whole[2]
    good = {tuple(row) for row in whole[1]}
    missing = [i for i in range(60) if tuple(COUNTS[i].astype(float)) not in good]
    assert len(missing) <= 2 * len(garbage) + 1  # the last packet may wait for what follows it


@given(st.integers(2, 59), st.integers(0, 32), st.integers(1, 255))
def test_one_wrong_byte_costs_at_most_one_packet_and_the_next_is_found(which: int, where: int, change: int) -> None:
    spoilt = bytearray(b"".join(PACKETS[:61]))
    spoilt[33 * which + where] ^= change
    counter, counts, _ = decoded([bytes(spoilt)])
    good = {tuple(row) for row in counts}
    missing = [i for i in range(60) if tuple(COUNTS[i].astype(float)) not in good]
    assert set(missing) <= {which}
    assert len(counter) >= 60


@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=8))
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int]) -> None:
    whole, pieced = decoded([data]), decoded(cut(data, cuts))
    assert whole[0].tolist() == pieced[0].tolist() and whole[2] == pieced[2]
    assert 33 * len(whole[0]) + whole[2] <= len(data)


def test_it_holds_at_most_one_packet_back() -> None:
    decoder = CytonDecoder()
    for _ in range(100):
        decoder.feed(RNG.integers(0, 256, 1000, dtype=np.uint8).tobytes())
        assert len(decoder._buffer) <= 33


def test_new_accelerations_are_those_that_are_not_zero() -> None:
    still, moved, analog = bytes(6), np.array([8000, -16000, 1], ">i2").tobytes(), np.array([1, 2, 3], ">i2").tobytes()
    data = packet(0, COUNTS[0], still) + packet(1, COUNTS[1], moved) + packet(2, COUNTS[2], analog, 0xC1) + b"\xa0"
    index, values = acceleration(CytonDecoder().feed(data))
    assert index.tolist() == [1]
    assert values.tolist() == [[1.0, -2.0, 0.000125]]


def test_commands() -> None:
    assert ChannelSetting(3).command == b"x3060110X"
    assert (
        ChannelSetting(9, gain=8, input="test", bias=False, srb2=False, srb1=True, power=False).command == b"xQ145001X"
    )
    assert [switch(1, False), switch(1, True), switch(8, True), switch(16, False), switch(16, True)] == [
        b"1",
        b"!",
        b"*",
        b"i",
        b"I",
    ]


# the simulated board -------------------------------------------------------------------------------------------------


def test_the_board_answers_as_the_documentation_says() -> None:
    brain = CytonModel(daisy=True)
    greeting = brain.receive(b"v")
    assert greeting.startswith(b"OpenBCI V3") and b"Daisy" in greeting and greeting.endswith(b"$$$")
    assert b"Daisy" not in CytonModel().receive(b"v")
    assert brain.receive(b"x30") == b"" and brain.receive(b"60110X") == b"Success: Channel set for 3$$$"
    assert brain.receive(b"x99X").startswith(b"Failure") and brain.receive(b"d").endswith(b"$$$")
    assert brain.say(1.0) == []
    brain.receive(b"b")
    assert brain.say(2.0) == [] and len(brain.say(3.0)) == 250
    brain.receive(b"s")
    assert brain.say(4.0) == []


# the source ----------------------------------------------------------------------------------------------------------


def served(brain: CytonModel, faults: FaultInjection = GOOD, address: str = "") -> Server:
    return Server(brain, line_at(address, "ttyCYTON"), faults)


def expected(brain: CytonModel, first: int, n: int, uv: float = uv_per_count(24)) -> np.ndarray:
    return np.stack([brain.counts(i) for i in range(first, first + n)]) * uv


@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
def test_what_the_board_measures_arrives_bit_for_bit(address: str) -> None:
    brain = CytonModel(seed=3)
    with served(brain, address=address) as server:
        source = Cyton(server.address)
        with reading(source) as feed:
            wait_for(lambda: feed.count("emg") >= 300)
    assert feed.error is None and not feed.problems
    check(source, feed)
    emg = feed.data("emg")
    assert np.array_equal(emg, expected(brain, 0, len(emg)))
    accel = feed.data("accel")
    truth = np.stack([brain.acceleration(10 * i) for i in range(len(accel))])
    assert np.abs(accel - truth).max() < 0.0001
    assert np.array_equal(feed.data("timing")["counter"], np.arange(len(emg)))
    assert np.array_equal(feed.data("timing")["stamp"], feed.time("emg"))
    assert (feed.data("timing")["arrival"] >= feed.time("emg") - 1000).all()
    assert np.median(np.diff(feed.time("emg"))) == pytest.approx(4e6, abs=2e4)


def test_a_daisy_brings_sixteen_channels_at_half_the_rate() -> None:
    brain = CytonModel(daisy=True, seed=4)
    with served(brain) as server:
        source = Cyton(server.address, daisy=True)
        with reading(source) as feed:
            wait_for(lambda: feed.count("emg") >= 100)
    check(source, feed)
    emg = feed.data("emg")
    daisy, board = expected(brain, 0, 2 * len(emg))[0::2], expected(brain, 0, 2 * len(emg))[1::2]
    assert emg.shape[1] == 16 and np.array_equal(emg, np.hstack([board, daisy]))
    assert feed.lost("emg") == {} and not feed.problems


def test_a_board_with_a_daisy_can_be_used_without_it() -> None:
    with served(CytonModel(daisy=True)) as server, reading(Cyton(server.address)) as feed:
        wait_for(lambda: feed.count("emg") >= 10)
    assert feed.data("emg").shape[1] == 8


def test_gains_and_switched_off_channels() -> None:
    brain = CytonModel(seed=5)
    settings = (ChannelSetting(1, gain=1), ChannelSetting(2, gain=12), ChannelSetting(3, power=False))
    with served(brain) as server, reading(Cyton(server.address, settings=settings)) as feed:
        wait_for(lambda: feed.count("emg") >= 100)
    emg = feed.data("emg")
    uv = np.array([uv_per_count(1), uv_per_count(12), *[uv_per_count(24)] * 6])
    assert np.array_equal(emg, np.stack([brain.counts(i) for i in range(len(emg))]) * uv)
    assert not emg[:, 2].any() and emg[:, 3].any()
    assert np.abs(emg[:, 0]).max() > 5, "the same uV come out at another gain"


def test_lost_repeated_and_broken_packets_are_counted_and_nothing_is_invented() -> None:
    brain = CytonModel(seed=6)
    wrong = FaultInjection(lose=0.05, duplicate=0.05, corrupt=0.02, from_s=0.0, seed=1)
    with served(brain, wrong) as server:
        source = Cyton(server.address)
        with reading(source) as feed:
            wait_for(lambda: feed.count("emg") >= 700)
        injector = server.injector
    check(source, feed)
    assert feed.error is None
    number = feed.data("timing")["counter"]
    assert (np.diff(number) > 0).all() and sum(feed.lost("emg").values()) == number[-1] - number[0] + 1 - len(number)
    assert feed.problems["lost packet"] > 20 and abs(feed.problems["repeated packet"] - injector.duplicated) <= 8
    assert feed.problems["resync"] > 0 and feed.problems["bytes that are no packet"] > 0
    truth = expected(brain, 0, int(number[-1]) + 1)[number]
    assert (feed.data("emg") == truth).all(
        axis=1
    ).mean() > 0.97  # a byte within a sample may be wrong: there is no checksum


def test_a_daisys_sample_is_lost_if_either_packet_is() -> None:
    brain = CytonModel(daisy=True, seed=6)
    with served(brain, FaultInjection(lose=0.1, seed=2)) as server, reading(Cyton(server.address, daisy=True)) as feed:
        wait_for(lambda: feed.count("emg") >= 200)
    number = feed.data("timing")["counter"].tolist()
    there = set(number)
    whole = [n // 2 for n in number if n % 2 == 0 and n + 1 in there]
    emg, counts = feed.data("emg"), expected(brain, 0, max(number) + 2)
    whole = whole[: len(emg)]
    assert np.array_equal(emg, np.hstack([counts[[2 * k + 1 for k in whole]], counts[[2 * k for k in whole]]]))
    assert sum(feed.lost("emg").values()) == whole[-1] - whole[0] + 1 - len(whole)


def test_a_stall_loses_nothing_and_stamps_stay_even() -> None:
    stalls = FaultInjection(stall_every_s=1.5, stall_s=0.7, from_s=0.5)
    with served(CytonModel(), stalls) as server, reading(Cyton(server.address)) as feed:
        wait_for(lambda: feed.count("emg") >= 900)
    assert feed.lost("emg") == {} and not feed.problems
    steps = np.diff(feed.time("emg")[100:])
    assert steps.max() < 20e6 and np.diff(feed.data("timing")["arrival"]).max() > 0.6e9


def test_a_counter_that_begins_again_is_marked_and_time_goes_on() -> None:
    with served(CytonModel(), FaultInjection(reset_every_s=1.1)) as server, reading(Cyton(server.address)) as feed:
        wait_for(lambda: feed.count("emg") >= 700)
    assert feed.problems["counter reset"] >= 1
    assert -1 in feed.lost("emg").values()
    late = feed.data("timing")["arrival"] - feed.time("emg")
    assert np.median(np.abs(late)) < 0.1e9 and late.max() < 2e9, "a stall of this machine delays some arrivals"


def test_a_silent_board_is_told_from_a_working_one() -> None:
    class Deaf(CytonModel):
        def say(self, seconds: float) -> list[bytes]:
            return []

    with served(Deaf()) as server, reading(Cyton(server.address)) as feed:
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "no packet" in str(feed.error) and "came nothing" in str(feed.error)


class Answers(CytonModel):
    """A board that answers everything in its own words."""

    def __init__(self, words: dict[str, bytes], **given: bool) -> None:
        super().__init__(**given)
        self._words = words

    def _obey(self, command: str) -> bytes:
        return self._words.get(command) or super()._obey(command)


class Emulator(CytonModel):
    """As BrainFlow's published emulator is: it knows v, b and s alone, and stops for good when it is stopped before it began."""

    began = dead = False

    def _obey(self, command: str) -> bytes:
        self.began |= command == "b"
        self.dead |= command == "s" and not self.began
        answer = super()._obey(command) if command in "bs" and not self.dead else b""
        return b"OpenBCI Emulator $$$" if command == "v" and not self.dead else answer


def test_a_board_that_answers_nothing_but_the_reset_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.cyton.source.ASIDE_S", 0.2)
    with served(Emulator()) as server, reading(Cyton(server.address)) as feed:
        wait_for(lambda: feed.count("emg") > 100 or feed.error is not None)
    assert feed.error is None and feed.problems["no answer to 'd'"] == 1


def test_settings_that_the_board_does_not_confirm_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.cyton.source.ASIDE_S", 0.1)
    monkeypatch.setattr("kinegraph.devices.cyton.source.ANSWER_S", 0.2)
    source = replace(Cyton(""), settings=(ChannelSetting(1, gain=1),))
    with served(Answers({"v": b"OpenBCI Emulator $$$"})) as server:
        server.brain._set_channel = lambda command: b""  # type: ignore[attr-defined]
        with reading(replace(source, port=server.address)) as feed:
            wait_for(lambda: feed.error is not None)
    assert "no answer within 0.2 s: expected an answer to 'x1" in str(feed.error)


@pytest.mark.parametrize(
    ("words", "source", "message"),
    [
        ({"v": b"Failure: Communications timeout - Device failed to poll Host$$$"}, {}, "is the board on"),
        ({"v": b"hello from something else\r\n$$$"}, {}, "names OpenBCI"),
        ({"d": b"Failure: no$$$"}, {}, "refused 'd'"),
        ({}, {"daisy": True}, "no Daisy is attached"),
        ({"v": b"\x01\x02 no ending"}, {}, "came 12 bytes: 01 02"),
    ],
)
def test_a_wrong_answer_is_told(
    words: dict[str, bytes], source: dict[str, bool], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.devices.cyton.source.ANSWER_S", 0.4)
    with served(Answers(words)) as server, reading(Cyton(server.address, **source)) as feed:
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and message in str(feed.error)


def test_no_port_at_all() -> None:
    with pytest.raises(DeviceError, match="does not exist"):
        Cyton("/dev/ttyNOTTHERE").read(Kept())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"port": "x", "channels": ["a", "b"]}, "8 different names"),
        ({"port": "x", "settings": [{"channel": 9}]}, "channels 1 to 8"),
        ({"port": "x", "settings": [{"channel": 2}, {"channel": 2}]}, "at most once"),
        ({"port": "x", "settings": [{"channel": 2, "gain": 5}]}, "gain is 5"),
        ({"port": "x", "settings": [{"channel": 2, "srb": True}]}, "srb"),
        ({}, "port is missing"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Cyton, given).specs()


def test_the_simulated_board_stands_in_for_the_real_one() -> None:
    source = Cyton("/dev/ttyUSB0", daisy=True)
    with source.simulated() as there:
        assert replace(there, port="/dev/ttyUSB0") == source
        with reading(there) as feed:
            wait_for(lambda: feed.count("emg") >= 20)
    assert Simulated(daisy=True).brain().receive(b"C") == b"16$$$"
