"""Delsys Trigno: samples cut anywhere, answers, counting; the source against the simulated base station on loopback sockets."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.devices.clocks.pace import DevicePace
from kinegraph.devices.clocks.rate_check import Policy, RateCheck
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.trigno import protocol as protocol
from kinegraph.devices.trigno.protocol import TrignoRows
from kinegraph.devices.trigno.simulator import Station, StationLine, TrignoModel
from kinegraph.devices.trigno.source import Trigno, TrignoSensor
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, ParameterError, RunError
from kinegraph.stream.params import build
from tests.support.device_feed import Kept, check, cut, reading, wait_for

RNG = np.random.default_rng(3)
SENSORS = (TrignoSensor(3, "TA"), TrignoSensor(1), TrignoSensor(16, "SO"))


# bytes ---------------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 2000), max_size=12))
def test_any_cut_gives_the_same_samples(cuts: list[int]) -> None:
    values = RNG.normal(size=(30, 16)).astype(np.float32)
    decoder = TrignoRows(16)
    found = [decoder.feed(piece) for piece in cut(protocol.rows(values.astype(float)), cuts)]
    assert np.array_equal(np.concatenate(found), values)


@given(st.binary(max_size=500), st.lists(st.integers(0, 500), max_size=6))
def test_no_bytes_whatever_make_it_fail(data: bytes, cuts: list[int]) -> None:
    whole, pieces = TrignoRows(3), TrignoRows(3)
    found = [pieces.feed(piece) for piece in cut(data, cuts)]
    assert np.array_equal(np.concatenate(found), whole.feed(data), equal_nan=True)


def test_a_sample_written_out_by_hand() -> None:
    assert TrignoRows(2).feed(bytes.fromhex("0000803f 000000c0 00")).tolist() == [[1.0, -2.0]]
    assert protocol.answers(b"OK\r\n\r\nYES\r\n\r\n3.6") == (["OK", "YES"], b"3.6")


# counting ------------------------------------------------------------------------------------------------------------


def counted(shift: dict[int, int], rate_hz: float = 2000.0, frames: int = 2000) -> tuple[list[int], np.ndarray]:
    """(frames at which the count was found astray, error of each frame's last stamp in ns); `shift`: samples left out before a frame."""
    pace, at, errors, missing = DevicePace(2000.0), [], [], 0
    for frame in range(frames):
        missing += shift.get(frame, 0)
        made = NS + round(((frame + 1) * 27 + missing) * NS / rate_hz)
        stall = int(0.2 * NS) if frame % 300 == 299 else 0
        found = pace.take(27, made + int(RNG.exponential(3e6)) + stall)
        at += [frame] if found.astray else []
        errors.append(int(found.stamp[-1]) - made)
        assert (np.diff(found.stamp) > 0).all()
    return at, np.array(errors)


def test_jitter_and_stalls_leave_the_count_alone() -> None:
    at, errors = counted({})
    assert at == [] and np.abs(errors[200:]).max() < 3_000_000


@pytest.mark.parametrize("missing", [400, 4000])
def test_samples_left_out_show_within_two_seconds(missing: int) -> None:
    at, errors = counted({800: missing})
    assert len(at) == 1 and 800 <= at[0] <= 950
    assert np.abs(errors[1200:]).max() < 5_000_000


@pytest.mark.parametrize("policy", ["fail", "warn"])
def test_another_rate_is_told(policy: Policy) -> None:
    pace, rate, feed, found = DevicePace(2000.0), RateCheck("server", 2000.0, policy, counted=True), Kept(), []
    for frame in range(2000):
        arrival = NS + round((frame + 1) * 26 * NS / 1925.9)
        pace.take(26, arrival)
        try:
            found += [hz] if (hz := rate.see(26, 0, arrival, feed)) else []
        except RunError as error:
            assert policy == "fail" and "1926" in str(error)
            return
    assert found == [pytest.approx(1925.9, rel=0.001)] and policy == "warn"


def test_a_duo_moves_the_columns_of_the_sensors_behind_it() -> None:
    brain = TrignoModel(duos=2)
    wanted = (TrignoSensor(1), TrignoSensor(1, channel=2), TrignoSensor(2, channel=2), TrignoSensor(3))
    feed = read(brain, 2000, sensors=wanted)
    n = feed.count("emg")
    assert np.allclose(feed.data("emg"), brain.emg(np.arange(n))[:, [0, 1, 3, 4]] * 1e6, rtol=1e-5, atol=1e-3)
    assert feed.identity["emg1.2_hz"] == "2000"
    assert "sensor 3 has 1 EMG channels" in str(read(brain, 1, sensors=(TrignoSensor(3, channel=2),)).error)


# the source ----------------------------------------------------------------------------------------------------------


@contextmanager
def station(brain: TrignoModel, faults: FaultInjection = GOOD) -> Iterator[Station]:
    with Station(brain, StationLine("tcp://127.0.0.1:0"), faults) as there:
        yield there


def read(brain: TrignoModel, n: int, faults: FaultInjection = GOOD, **given: object) -> Kept:
    with station(brain, faults) as there:
        source = replace(Trigno(there.address, SENSORS), **given)  # type: ignore[arg-type]
        with reading(source) as feed:
            wait_for(lambda: feed.error is not None or feed.count("emg") >= n, 60)
    if feed.chunks:
        check(source, feed)
    return feed


@pytest.mark.parametrize("layout", ["legacy", "current"])
def test_what_the_sensors_measure_arrives(layout: str) -> None:
    brain = TrignoModel(seed=3)
    feed = read(brain, 3000, aux=True, layout=layout)
    assert feed.error is None and not feed.problems and feed.lost("emg") == {} == feed.lost("aux")
    emg = brain.emg(np.arange(feed.count("emg")))[:, [2, 0, 15]]
    np.testing.assert_allclose(feed.data("emg"), emg * 1e6, rtol=1e-6)
    per = 3 if layout == "legacy" else 9
    places = [s * per + i for s in (2, 0, 15) for i in range(per)]
    aux = brain.aux(np.arange(feed.count("aux")), layout)[:, places]  # type: ignore[arg-type]
    np.testing.assert_allclose(feed.data("aux"), aux, rtol=1e-6, atol=1e-7)
    assert feed.count("aux") == pytest.approx(feed.count("emg") * 2 / 27, abs=60)
    assert np.median(np.diff(feed.time("emg"))) == pytest.approx(NS / 2000, rel=0.01)
    assert feed.identity["server"] == "3.6.0" and feed.identity["TA_serial"] == "SP-W02A-1003"


def test_channels_have_the_names_of_the_graph() -> None:
    specs = Trigno("tcp://x:1", SENSORS, True).specs()
    assert specs["emg"].channels == ("TA", "emg1", "SO") and specs["emg"].units == ("uV",)
    assert specs["aux"].channels[:4] == ("TA.ax", "TA.ay", "TA.az", "emg1.ax")
    assert Trigno("tcp://x:1", SENSORS).outputs == ("emg", "timing")


def test_what_goes_wrong_is_counted() -> None:
    feed = read(TrignoModel(), 2500, FaultInjection(corrupt=0.2, seed=2))
    assert feed.error is None and feed.problems["impossible value"] >= np.isnan(feed.data("emg")).sum() > 0
    feed = read(TrignoModel(), 9000, FaultInjection(lose=0.12, seed=2), rate_mismatch="warn")
    assert feed.error is None and feed.problems["lost count"] >= 1 and -1 in feed.lost("emg").values()


def test_a_stall_is_no_loss() -> None:
    assert not read(TrignoModel(), 3500, FaultInjection(stall_every_s=1.0, stall_s=0.3)).problems


def test_unplugged_in_mid_sample() -> None:
    with station(TrignoModel()) as there:
        for _ in range(2):
            with reading(Trigno(there.address, SENSORS, aux=True)) as feed:
                wait_for(lambda feed=feed: feed.count("aux") >= 20)
                there.unplug()
                wait_for(lambda feed=feed: feed.error is not None)
            assert isinstance(feed.error, DeviceError)
            there.plug()


def test_a_sensor_that_is_not_there_is_told() -> None:
    feed = read(TrignoModel(paired=10), 1)
    assert "sensor 16 is not paired" in str(feed.error)


def test_an_old_server_that_knows_few_commands_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Old(TrignoModel):
        def _obey(self, command: str) -> str:
            return super()._obey(command) if command in ("START", "STOP") else "INVALID COMMAND"

    feed = read(Old(), 100)
    assert feed.error is None and set(feed.identity) == {"device", "port", "server"}


@pytest.mark.parametrize(("greeting", "message"), [(b"SSH-2.0\r\n\r\n", "53 53 48"), (b"", "came nothing")])
def test_another_server_is_told(greeting: bytes, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.trigno.source.ANSWER_S", 0.3)
    server = socket.create_server(("127.0.0.1", 0))
    with server, reading(Trigno(f"tcp://127.0.0.1:{server.getsockname()[1]}", SENSORS)) as feed:
        client, _ = server.accept()
        with client:
            client.sendall(greeting)
            wait_for(lambda: feed.error is not None)
    assert "the greeting of a Trigno server" in str(feed.error) and message in str(feed.error)


def test_a_server_that_falls_silent_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent(TrignoModel):
        def say(self, seconds: float) -> list[bytes]:
            return super().say(seconds) if self._said < 20 else []

    monkeypatch.setattr("kinegraph.devices.trigno.source.SILENCE_S", 0.5)
    feed = read(Silent(), 10**9)
    assert isinstance(feed.error, DeviceError) and "no samples of emg" in str(feed.error)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sensors": []}, "1 to 16 different sensors"),
        ({"sensors": [{"sensor": 1}, {"sensor": 1, "name": "x"}]}, "1 to 16 different sensors"),
        ({"sensors": [{"sensor": 17}]}, "sensor"),
        ({"sensors": [{"sensor": 1}], "port": "/dev/ttyUSB0"}, "tcp://host:port"),
    ],
)
def test_what_cannot_be_is_refused(given: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        build(Trigno, {"port": "tcp://x:1", **given}).specs()
