"""Xsens MTi: the source against the simulated sensor, on a serial line, by TCP and on USB; misbehaviour; steps with known truth."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.clocks.tick_clock import TickClock
from kinegraph.devices.mti import xbus
from kinegraph.devices.mti.simulator import MtiModel
from kinegraph.devices.mti.simulator import SimulatedMti as Simulated
from kinegraph.devices.mti.source import Mti
from kinegraph.devices.people.walking_limb import Limb
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import build
from kinegraph.stream.recording.read.reader import Recording
from tests.support.device_feed import Kept, check, reading, wait_for

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "imu_steps.yaml"
FAST = {"rate_hz": 2000, "high_rate": True, "baud": 2_000_000}


def served(brain: MtiModel, faults: FaultInjection = GOOD, address: str = "") -> Server:
    return Server(brain, line_at(address, "ttyMTI"), faults)


def read(server: Server, n: int, **given: object) -> tuple[Mti, Kept]:
    """The source and what it gave until `n` samples had come, checked against its specs."""
    source = build(Mti, {"port": server.address, **given})
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("imu") >= n, 60)
    if feed.chunks:
        check(source, feed)
    return source, feed


def truth(brain: MtiModel, source: Mti, number: np.ndarray) -> np.ndarray:
    """What the limb did at the packets of these numbers."""
    every = np.arange(int(number[0]), int(number[-1]) + 1)
    made = brain.limb.measure(every)
    return np.hstack([made[name] for name in source.ordered])[number - number[0]]


# the source ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"measure": ["orientation", "acceleration", "angular_velocity", "magnetic_field"]},
        {"rate_hz": 400, "baud": 460800},
    ],
)
@pytest.mark.parametrize("address", ["", "tcp://127.0.0.1:0"])
def test_what_the_sensor_measures_arrives(address: str, given: dict[str, object]) -> None:
    brain = MtiModel(seed=3)
    with served(brain, address=address) as server:
        source, feed = read(server, 400, **given)
    assert feed.error is None and not feed.problems
    number = feed.data("timing")["counter"]
    assert np.array_equal(number, np.arange(len(number)))
    np.testing.assert_allclose(feed.data("imu"), truth(brain, source, number), rtol=1e-6, atol=1e-6)
    assert np.array_equal(feed.data("timing")["stamp"], feed.time("imu"))
    assert np.array_equal(feed.data("timing")["device"], number * NS // source.rate_hz)
    assert (feed.data("timing")["arrival"] >= feed.time("imu") - 1000).all()
    assert np.median(np.diff(feed.time("imu"))) == pytest.approx(NS / source.rate_hz, rel=0.01)


def test_channels_and_units_are_those_asked_for() -> None:
    spec = Mti("/dev/ttyUSB0", measure=("orientation", "acceleration")).specs()["imu"]
    assert spec.channels == ("ax", "ay", "az", "qw", "qx", "qy", "qz")
    assert spec.units == ("m/s2",) * 3 + ("",) * 4


def test_two_thousand_a_second() -> None:
    """A pseudo-terminal holds some 60 ms of it: where the machine was busy elsewhere for longer, once more."""
    for _ in range(4):
        brain = MtiModel(seed=5)
        with served(brain) as server:
            source, feed = read(server, 3000, **FAST)
        if not feed.problems:
            break
    assert feed.error is None and not feed.problems and feed.lost("imu") == {}
    n = feed.count("imu")
    np.testing.assert_allclose(feed.data("imu"), truth(brain, source, np.arange(n)), rtol=1e-6, atol=1e-6)
    assert feed.count("timing") == len(feed.chunks["imu"]) < n / 4


def test_settings_are_written_only_where_they_differ() -> None:
    brain = MtiModel()
    with served(brain) as server:
        for _ in range(2):
            read(server, 5)
        assert brain.stored == 1
        read(server, 5, rate_hz=50)
        assert brain.stored == 2


def test_lost_repeated_and_damaged_packets_are_counted_and_nothing_is_invented() -> None:
    brain = MtiModel(seed=6)
    with served(brain, FaultInjection(lose=0.05, duplicate=0.05, corrupt=0.03, seed=1)) as server:
        source, feed = read(server, 900, rate_hz=400, baud=460800)
        injector = server.injector
    assert feed.error is None
    number = feed.data("timing")["counter"]
    np.testing.assert_allclose(feed.data("imu"), truth(brain, source, number), rtol=1e-6, atol=1e-6)
    assert sum(feed.lost("imu").values()) == number[-1] - number[0] + 1 - len(number) == feed.problems["lost packet"]
    assert (
        abs(feed.problems["lost packet"] - injector.lost - injector.corrupted) <= 12
    )  # those spoilt twice, or at the end
    assert abs(feed.problems["repeated packet"] - injector.duplicated) <= 8
    assert feed.problems["resync"] > 0 and feed.problems["bytes that are no packet"] > 0


def test_a_stall_loses_nothing_and_stamps_stay_even() -> None:
    with served(MtiModel(), FaultInjection(stall_every_s=1.5, stall_s=0.7, from_s=0.5)) as server:
        _, feed = read(server, 400)
    assert feed.lost("imu") == {} and not feed.problems
    assert np.diff(feed.time("imu")[30:]).max() < 20e6 and np.diff(feed.data("timing")["arrival"]).max() > 0.6e9


def test_counters_that_begin_again_are_marked_and_time_goes_on() -> None:
    with served(MtiModel(), FaultInjection(reset_every_s=1.3)) as server:
        _, feed = read(server, 300)
    assert feed.problems["counter reset"] >= 1 and -1 in feed.lost("imu").values()
    assert np.abs(feed.data("timing")["arrival"] - feed.time("imu")).max() < 0.5e9


def test_other_measurements_between_are_passed_over_and_not_lost() -> None:
    """As an MTi-G sends its fixes: with the next counter, and an earlier time."""

    class WithFixes(MtiModel):
        def packets(self, first: int, stop: int) -> list[bytes]:
            rows = []
            for i, packet in enumerate(super().packets(first, stop), first):
                data = bytearray(packet[4:-1])
                data[3:5] = ((i + i // 10) % 65536).to_bytes(2, "big")
                rows.append(xbus.message(xbus.MEASUREMENT, bytes(data)))
                if i % 10 == 9:
                    parts = [
                        xbus.item(0x7010, bytes(94)),
                        xbus.item(xbus.SAMPLE_TIME_FINE, (100 * i - 600).to_bytes(4, "big", signed=True)),
                        xbus.item(xbus.PACKET_COUNTER, ((i + i // 10 + 1) % 65536).to_bytes(2, "big")),
                    ]
                    rows.append(xbus.message(xbus.MEASUREMENT, b"".join(parts)))
            return rows

    brain = WithFixes(seed=2)
    with served(brain) as server:
        source, feed = read(server, 200)
    assert feed.error is None and not feed.problems and feed.lost("imu") == {}
    np.testing.assert_allclose(
        feed.data("imu"), truth(brain, source, np.arange(feed.count("imu"))), rtol=1e-6, atol=1e-6
    )


def test_measurements_in_one_read_with_the_last_answer_are_samples() -> None:
    class AtOnce(MtiModel):
        """The first ten follow the answer without a pause."""

        def _obey(self, mid: int, data: bytes) -> bytes:
            answer = super()._obey(mid, data)
            if mid == xbus.GO_TO_MEASUREMENT:
                self._said = 10
                answer += b"".join(self.packets(0, 10))
            return answer

    brain = AtOnce()
    with served(brain) as server:
        source, feed = read(server, 100)
    number = feed.data("timing")["counter"]
    assert np.array_equal(number, np.arange(len(number))) and not feed.problems
    np.testing.assert_allclose(feed.data("imu"), truth(brain, source, number), rtol=1e-6, atol=1e-6)


# what goes wrong -----------------------------------------------------------------------------------------------------


class Answers(MtiModel):
    """A sensor that answers some messages in its own words."""

    def __init__(self, words: dict[int, bytes]) -> None:
        super().__init__()
        self._words = words

    def _obey(self, mid: int, data: bytes) -> bytes:
        return self._words[mid] if mid in self._words else super()._obey(mid, data)


@pytest.mark.parametrize(
    ("words", "given", "message"),
    [
        ({xbus.GO_TO_CONFIG: b"$GPGGA,hello\r\n"}, {}, "expected FA FF 31 after message 30"),
        ({xbus.GO_TO_CONFIG: b""}, {}, "is it an MTi, in Xbus mode, and `baud` as set in it"),
        (
            {xbus.REQUEST_PRODUCT: xbus.message(xbus.ERROR, b"\x04")},
            {},
            "refused message 1C: an invalid message",
        ),
        ({}, {"rate_hz": 1000, "baud": 921600}, "was asked for acceleration at 1000 Hz and offers 400 Hz"),
        ({xbus.OUTPUT_CONFIGURATION: xbus.message(0xC1)}, {}, "asked for acceleration at 100 Hz and offers nothing"),
    ],
)
def test_a_wrong_answer_is_told(
    words: dict[int, bytes], given: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.devices.mti.xbus_commands.ANSWER_S", 0.3)
    brain = Answers(words)
    brain._measuring = False
    with served(brain) as server:
        _, feed = read(server, 1, **given)
    assert isinstance(feed.error, DeviceError) and message in str(feed.error)


def test_a_sensor_that_falls_silent_or_was_switched_on_again_is_opened_again() -> None:
    class Silent(MtiModel):
        def say(self, seconds: float) -> list[bytes]:
            return super().say(seconds) if self._said < 50 else []

    class SwitchedOn(MtiModel):
        def packets(self, first: int, stop: int) -> list[bytes]:
            return [*super().packets(first, stop), *([xbus.message(xbus.WAKE_UP)] if stop > 50 else [])]

    for brain, reported in ((Silent(), "no measurement"), (SwitchedOn(), "restarted")):
        with served(brain) as server:
            _, feed = read(server, 10**9)
        assert isinstance(feed.error, DeviceError) and reported in str(feed.error)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"port": "x", "measure": []}, "each once"),
        ({"port": "x", "measure": ["speed"]}, "measure"),
        ({"port": "x", "high_rate": True, "measure": ["orientation"]}, "orientation left out"),
        ({"port": "x", "rate_hz": 400}, "baud is 115200; it must be at least"),
        ({"port": "x", "rate_hz": 2001}, "rate_hz is 2001"),
        ({}, "port is missing"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Mti, given).specs()
    assert build(Mti, {"port": "usb://2639", "rate_hz": 400}).specs()


# the clock -----------------------------------------------------------------------------------------------------------


def clock() -> TickClock:
    return TickClock(counter_bits=16, tick_bits=32, tick_ns=100_000, rate_hz=100)


@pytest.mark.parametrize("size", [1, 7, 500])
def test_both_numbers_wrap(size: int) -> None:
    numbers = np.arange(65_000, 66_000)
    counters, ticks = numbers % 65536, (2**32 - 50_000 + 100 * (numbers - numbers[0])) % 2**32
    made = clock()
    parts = [
        made.take(counters[i : i + size], ticks[i : i + size], int(NS + (i + size) * 10_000_000))
        for i in range(0, len(numbers), size)
    ]
    assert np.array_equal(np.concatenate([p.number for p in parts]), numbers)
    assert not np.concatenate([p.lost for p in parts]).any()
    device = np.concatenate([p.device for p in parts])
    assert np.array_equal(np.diff(device), np.full(999, 10_000_000))
    assert (np.diff(np.concatenate([p.stamp for p in parts])) > 0).all()


def test_an_outage_of_whole_turns_of_the_counter_is_counted_by_the_sensors_time() -> None:
    made = clock()
    made.take(np.array([5]), np.array([500]), NS)
    later = 200_000
    packets = made.take(np.array([(5 + later) % 65536]), np.array([500 + 100 * later]), NS + later * 10_000_000)
    assert packets.lost.tolist() == [later - 1] and packets.number.tolist() == [5 + later]


def test_a_restart_within_a_read() -> None:
    made = clock()
    made.take(np.arange(100), 100 * np.arange(100), NS)
    counters, ticks = np.array([100, 101, 0, 1]), np.array([10_000, 10_100, 0, 100])
    packets = made.take(counters, ticks, 2 * NS)
    assert packets.lost.tolist() == [0, 0, -1, 0] and packets.number.tolist() == [100, 101, 102, 103]
    assert (np.diff(packets.stamp) > 0).all()
    assert made.take(np.array([2]), np.array([200]), 2 * NS).number.tolist() == [104]


# the cable, the whole graph ------------------------------------------------------------------------------------------


@contextmanager
def recorded(folder: Path, *more: str) -> Iterator[Recording]:
    """The steps config, run for a while on the simulated sensor."""
    command = [
        sys.executable,
        "-m",
        "kinegraph",
        "run",
        str(CONFIG),
        "--simulate",
        "--for",
        "12",
        "-o",
        str(folder),
    ]
    done = subprocess.run(
        [*command, "--view", "none", *more],
        capture_output=True,
        text=True,
        timeout=120,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "COLUMNS": "160"},
    )
    assert done.returncode == 0, done.stderr
    with Recording.open(folder) as recording:
        yield recording


@pytest.mark.parametrize("port", ["/dev/ttyUSB0", "usb://2639"])
@pytest.mark.nightly
def test_steps_agree_with_the_simulated_walk(port: str, tmp_path: Path) -> None:
    with recorded(tmp_path / "session", "--set", f"mti.port={port}") as recording:
        stamp, _ = recording.read("mti.imu")
        number = recording.read("mti.timing")[1]["counter"]
        found = {name: recording.read(f"steps.{name}")[1]["onset"] for name in ("touchdown", "liftoff")}
    gait, first, last = Limb("foot", 100.0).gait, int(number[0]), int(number[-1])
    assert np.array_equal(number, np.arange(first, last + 1))
    for name, at in (("touchdown", gait.touchdowns(first, last - 60)), ("liftoff", gait.liftoffs(first, last - 60))):
        true = stamp[at - first]
        off = np.array([np.abs(found[name] - t).min() for t in true])
        assert len(true) >= 9 and abs(len(found[name]) - len(true)) <= 1
        assert np.median(off) < 10e6 and off[1:].max() < 20e6, name


def test_the_simulated_sensor_stands_in_for_the_real_one() -> None:
    for port in ("/dev/ttyUSB0", "usb://2639"):
        source = Mti(port)
        with source.simulated() as there:
            assert replace(there, port=port) == source
            with reading(there) as feed:
                wait_for(lambda feed=feed: feed.count("imu") >= 5)
    assert Simulated().brain().receive(xbus.message(xbus.REQUEST_DEVICE_ID)) == xbus.message(xbus.ERROR, b"\x04")
