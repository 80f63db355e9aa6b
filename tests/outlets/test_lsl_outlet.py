"""LSL outlets, read by plain pylsl inlets; and the network's settings."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.lsl import LslInlet
from kinegraph.devices.lsl.network import Network, library
from kinegraph.devices.lsl.outlet import LslOutlet
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError, InputError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from kinegraph.stream.system.clock import SessionClock
from tests.support.device_feed import reading, wait_for


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """A stream's name that no other test uses."""
    return str(request.node.name)


EVENT = np.dtype(
    [("onset", "<i8"), ("end", "<i8"), ("cause", "<U8"), ("speed", "<f8"), ("curve", "<f4", (2,)), ("ok", "?")]
)
EVENTS = StreamSpec((), EVENT, units=("ns", "ns", "", "m/s", "uV", ""))


@contextmanager
def opened(outlet: LslOutlet, spec: StreamSpec, *, live: bool = True) -> Iterator[tuple[LslOutlet, SessionClock]]:
    clock = SessionClock()
    outlet.open({"in": spec})
    if live:
        outlet.keep_time(clock)
    outlet.begin()
    try:
        yield outlet, clock
    finally:
        outlet.close()


def chunk_of(spec: StreamSpec, data: Any, start: int) -> Chunk:
    array = np.array(data, spec.dtype)
    times = start + np.arange(len(array)) * 1_000_000
    return Chunk(times, array, int(times[-1]))


def pulled(inlet: Any, n: int) -> tuple[list[Any], Array]:
    data, stamps = inlet.pull_chunk(5.0, n)
    assert len(stamps) == n
    return data, np.array(stamps)


@contextmanager
def listening(name: str) -> Iterator[Any]:
    """A plain pylsl inlet, as any other program has it."""
    lsl = library()
    (info,) = lsl.resolve_byprop("name", name, 1, 5.0)
    inlet = lsl.StreamInlet(info)
    inlet.open_stream(5.0)
    yield inlet
    inlet.close_stream()


@pytest.mark.parametrize("dtype", ["<f8", "<f4", "<i2", "<u1", "|b1", "<i8"])
def test_numbers_go_out_bit_for_bit_with_their_stamps(name: str, dtype: str) -> None:
    name = name.strip("]")
    spec = StreamSpec(
        (3,), dtype, rate_hz=1000.0, channels=("a", "b", "c"), units=("uV", "uV", "g"), meta={"xdf_type": "EMG"}
    )
    data = np.random.default_rng(1).integers(0, 2 if dtype == "|b1" else 100, (50, 3)).astype(dtype)
    if dtype.startswith("<f"):
        data = data / np.array(7, dtype)
        data[3, 1] = np.nan
    with opened(LslOutlet(name), spec) as (outlet, clock), listening(name) as inlet:
        begin = clock.now()
        outlet.process("in", chunk_of(spec, data[:20], begin))
        outlet.process("in", Chunk(np.empty(0, np.int64), data[:0], begin + NS))
        outlet.process("in", chunk_of(spec, data[20:], begin + 500_000_000))
        rows, stamps = pulled(inlet, 50)
        info = inlet.info()
    assert np.array_equal(np.array(rows).astype(dtype), data, equal_nan=dtype.startswith("<f"))
    expected = np.concatenate([np.arange(20), np.arange(30) + 500]) * 1_000_000 + begin
    mine = stamps * NS + clock.at(0)
    assert np.abs(mine - expected).max() < 20_000, "LSL's clock is the monotonic one"
    assert info.get_channel_labels() == ["a", "b", "c"] and info.get_channel_units() == [
        "microvolts",
        "microvolts",
        "g",
    ]
    assert info.get_channel_types() == ["EMG"] * 3 and info.type() == "EMG" and info.nominal_srate() == 1000.0
    assert info.source_id() == f"kinegraph.{info.hostname()}.{name}"
    assert StreamSpec.from_json(json.loads(info.desc().child("kinegraph").child_value("spec"))) == spec


def events(start: int) -> Array:
    row = [(start, start + 20, "heel", 1.25, (1, 2), True), (start - NS, 0, "toe", np.nan, (3, 4), False)]
    return np.array(row, EVENT)


def test_events_go_out_as_json(name: str) -> None:
    with opened(LslOutlet(name), EVENTS) as (outlet, clock), listening(name) as inlet:
        begin = clock.now()
        outlet.process("in", chunk_of(EVENTS, events(begin), begin))
        rows, stamps = pulled(inlet, 2)
        assert inlet.info().type() == "Markers"
    first = {"onset": begin, "end": begin + 20, "cause": "heel", "speed": 1.25, "curve": [1.0, 2.0], "ok": True}
    assert [json.loads(text) for (text,) in rows] == [
        first,
        {"onset": begin - NS, "end": 0, "cause": "toe", "speed": None, "curve": [3.0, 4.0], "ok": False},
    ]
    assert np.abs(np.diff(stamps) - 0.001).max() < 1e-6


def test_events_go_out_as_one_field_or_as_numbers(name: str) -> None:
    field = LslOutlet(f"{name}.f", events="field", fields=("cause",))
    numbers = LslOutlet(f"{name}.n", events="numbers", fields=("onset", "end", "speed", "ok"), type="Contacts")
    with opened(field, EVENTS) as (outlet, clock), listening(f"{name}.f") as inlet:
        outlet.process("in", chunk_of(EVENTS, events(clock.now()), clock.now()))
        assert pulled(inlet, 2)[0] == [["heel"], ["toe"]]
    with opened(numbers, EVENTS) as (outlet, clock), listening(f"{name}.n") as inlet:
        begin = clock.now()
        outlet.process("in", chunk_of(EVENTS, events(begin), begin))
        rows, _ = pulled(inlet, 2)
        info = inlet.info()
    assert np.allclose(rows, [[0, 2e-8, 1.25, 1], [-1.001, np.nan, np.nan, 0]], atol=1e-12, equal_nan=True)
    assert info.get_channel_units() == ["s", "s", "m/s", None] and info.type() == "Contacts"


@pytest.mark.parametrize(
    ("outlet", "spec", "message"),
    [
        (LslOutlet("x", fields=("cause",)), EVENTS, "events: field"),
        (LslOutlet("x", events="field"), EVENTS, "one of the event's fields"),
        (LslOutlet("x", events="field", fields=("couse",)), EVENTS, "did you mean 'cause'"),
        (LslOutlet("x", events="numbers"), EVENTS, "a field that is one number"),
        (LslOutlet("x", fields=("a",)), StreamSpec((1,)), "the input is not an event"),
        (LslOutlet("x"), StreamSpec((480, 640), "<u2"), "1 to 4096 numbers a sample"),
        (LslOutlet("x"), StreamSpec((2,), "<c16"), "real numbers"),
    ],
)
def test_what_cannot_go_out_is_told_when_the_graph_is_opened(outlet: LslOutlet, spec: StreamSpec, message: str) -> None:
    with pytest.raises((ParameterError, InputError), match=message):
        outlet.open({"in": spec})


def test_without_a_name_nothing_goes_out() -> None:
    outlet = LslOutlet("")
    outlet.open({"in": StreamSpec((2,))})
    outlet.begin()
    outlet.process("in", Chunk(np.array([0]), np.zeros((1, 2)), 0))
    assert outlet.runtime.outlet is None
    outlet.close()


def test_a_replayed_session_is_stamped_with_the_present(name: str) -> None:
    spec = StreamSpec((1,), rate_hz=1000.0)
    with opened(LslOutlet(name), spec, live=False) as (outlet, _), listening(name) as inlet:
        outlet.process("in", chunk_of(spec, np.zeros((10, 1)), 1_500_000_000 * NS))
        outlet.process("in", chunk_of(spec, np.ones((10, 1)), 1_500_000_100 * NS))
        _, stamps = pulled(inlet, 20)
    assert abs(stamps[9] - library().local_clock()) < 5.0 and stamps[10] - stamps[0] == pytest.approx(100.0, abs=1e-5)


def test_an_outlet_is_silent_in_replay(name: str, tmp_path: Path) -> None:
    from kinegraph.stream.engine.replay import Replay

    text = f"nodes:\n  board: {{use: parts.Counting}}\n  out: {{use: devices.lsl.LslOutlet, from: board, name: {name}}}"
    graph = load_text(text, path=str(Path(__file__).parent / "graph.yaml"))
    assert Session(graph, tmp_path / "s").run().exit_code == 0
    with Recording.open(tmp_path / "s") as recording:
        replay = Replay(graph, recording)
        assert not replay.pipeline.outlets


# the network ---------------------------------------------------------------------------------------------------------


def test_the_settings_of_a_closed_network() -> None:
    text = Network(scope="machine", session="lab 3").text()
    for line in (
        "ResolveScope = machine",
        "ListenAddress = 127.0.0.1",
        "KnownPeers = {127.0.0.1}",
        "SessionID = lab 3",
    ):
        assert line in text.splitlines()
    assert "AddressesOverride = {127.0.0.1}" in text and "IPv6 = disable" in text
    wide = Network(scope="site", peers=("10.0.0.5", "10.0.0.6")).text()
    assert "ResolveScope = site" in wide and "KnownPeers = {10.0.0.5, 10.0.0.6}" in wide and "127.0.0.1" not in wide


def test_settings_are_one_for_the_process_and_stay() -> None:
    assert os.environ["KINEGRAPH_LSL"].startswith("machine:")
    lsl = library()
    info = lsl.StreamOutlet(lsl.StreamInfo("settings", "x", 1, 0.0, "int8", "settings")).get_info()
    assert info.session_id() == os.environ["KINEGRAPH_LSL"].partition(":")[2]
    with pytest.raises(DeviceError, match="one for the whole process"):
        library(Network(session="another"))
    with (
        pytest.raises(DeviceError, match="one for the whole process"),
        reading(LslInlet(name="x", channels=1, network=Network(scope="global"))) as feed,
    ):
        wait_for(lambda: feed.error is not None)
        raise feed.error or AssertionError
