"""The Lab Streaming Layer on this computer's loopback: inlets against senders that die, come back, lose and lie; outlets read by pylsl."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest

from devices.lsl import LslInlet, LslOutlet
from devices.lsl.network import Network, library
from devices.simulators.lsl import Lsl, Sender
from devices.simulators.misbehaviour import Misbehaviour
from stream.chunk import NS, Array, Chunk, StreamSpec
from stream.engine.clock import SessionClock
from stream.engine.session import Session
from stream.errors import DeviceError, GraphError, InputError, ParameterError
from stream.graph.load import load_text
from stream.recording import Recording
from tests.device_feed import Kept, check, reading, wait_for
from tests.lsl_sender import process

MUSCLES = ("TA", "GM", "SO", "RF")
EMG = LslInlet(channels=MUSCLES, rate_hz=1000.0, unit="uV", type="EMG")
SENDER = Lsl(channels=MUSCLES, rate_hz=1000.0)


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """A stream's name that no other test uses."""
    return request.node.name


def sample_numbers(feed: Kept, output: str = "out", rate_hz: float = 1000.0) -> Array:
    """Which samples of the simulated walk have come; their stamps say it, and must say it within 0.1 ms."""
    exact = (feed.time(output) - feed._offset) / NS * rate_hz
    number = np.round(exact).astype(np.int64)
    assert np.abs(exact - number).max() < 1e-4 * rate_hz
    return number


def assert_exact(feed: Kept, sender: Lsl) -> Array:
    """Every sample is the one that its stamp says; returns their numbers."""
    number, signal = sample_numbers(feed), sender.signal()
    edges = [0, *(np.flatnonzero(np.diff(number) != 1) + 1), len(number)]
    for start, stop in pairwise(edges):
        wanted = signal.read(int(number[start]), int(number[stop - 1]) + 1)[0].astype(np.float32)
        assert np.array_equal(feed.data("out")[start:stop], wanted)
    return number


# the inlet -----------------------------------------------------------------------------------------------------------


def test_samples_of_another_process_arrive_as_they_are(name: str) -> None:
    source = replace(EMG, name=name)
    with process(name=name, channels=list(MUSCLES), rate_hz=1000), reading(source) as feed:
        wait_for(lambda: feed.count("out") > 1500 or feed.error is not None)
    assert feed.error is None and not feed.problems
    check(source, feed)
    number = assert_exact(feed, SENDER)
    assert (np.diff(number) == 1).all() and not feed.lost("out")
    timing = feed.data("timing")
    assert timing["counter"][-1] < len(number) and (timing["arrival"] >= timing["stamp"]).all()
    assert np.array_equal(timing["stamp"], feed.time("out")[timing["counter"]])
    assert np.abs(timing["device"] + feed._offset - timing["stamp"]).max() < 100_000


def test_a_sender_that_is_killed_and_started_again_is_found_and_the_loss_marked(name: str) -> None:
    source, settings = replace(EMG, name=name, lost_after_s=30.0), {"name": name, "channels": list(MUSCLES)}
    with process(**settings) as first, reading(source) as feed:
        wait_for(lambda: feed.count("out") > 500)
        first.kill()
        before = feed.count("out")
        with process(**settings):
            wait_for(lambda: feed.count("out") > before + 500)
    assert feed.error is None and feed.problems == {"connected anew": 1, "gap": 1}
    check(source, feed)
    number = assert_exact(feed, SENDER)
    leap = int(np.flatnonzero(np.diff(number) != 1)[0]) + 1
    assert feed.lost("out") == {leap: -1} and list(feed.lost("timing").values()) == [-1]


def test_the_session_finds_a_sender_that_comes_back_as_another(name: str, tmp_path: Path) -> None:
    """With another source_id LSL does not know it again: the inlet gives up, and the engine looks for the stream anew."""
    text = f"""
nodes:
  emg: {{use: devices.lsl.LslInlet, name: {name}, channels: {list(MUSCLES)}, rate_hz: 1000, unit: uV, lost_after_s: 0.5}}
  clock: {{use: parts.Counting, samples: 1000000, chunk: 10, realtime: true}}
  out: {{use: parts.Collect, from: emg, name: {name}}}
"""
    session = Session(load_text(text, path=str(Path(__file__).parent / "graph.yaml")), tmp_path / "s")
    outcomes: list[Any] = []
    thread = threading.Thread(target=lambda: outcomes.append(session.run()), daemon=True)
    with running(replace(SENDER, name=name, source_id=f"{name}.a")) as sender:
        thread.start()
        wait_for(lambda: samples(name) > 200)
        sender.unplug()
        before = samples(name)
        with running(replace(SENDER, name=name, source_id=f"{name}.b")):
            wait_for(lambda: samples(name) > before + 200)
            session.stop()
            thread.join(10)
    assert outcomes and outcomes[0].exit_code == 0, outcomes
    assert [c.lost for c in parts.seen[name] if c.lost] == [-1]
    with Recording.open(tmp_path / "s") as recording:
        failed = [e for e in recording.log if e["kind"] == "source failed"]
        assert len(failed) == 1 and "has brought nothing for" in failed[0]["error"]
        assert recording.streams["clock"].gaps == 0, "the rest of the graph went on"


def samples(name: str) -> int:
    return sum(len(c) for c in parts.seen.get(name, ()))


@contextmanager
def running(sender: Lsl, misbehaviour: Misbehaviour | None = None) -> Iterator[Sender]:
    with sender.sending(misbehaviour or Misbehaviour()) as at_work:
        yield at_work


def test_lost_blocks_of_an_even_sender_are_counted(name: str) -> None:
    sender, wrong = replace(SENDER, name=name, source_id=name), Misbehaviour(lose=0.1, from_s=2.5, seed=2)
    with reading(replace(EMG, source_id=name)) as feed, running(sender, wrong) as at_work:
        wait_for(lambda: at_work.mishaps.lost > 5 and feed.count("out") > 3000)
    number = assert_exact(feed, sender)
    leaps = np.diff(number) - 1
    assert feed.lost("out") == {int(i) + 1: int(leaps[i]) for i in np.flatnonzero(leaps)}
    assert feed.problems == {"lost sample": int(leaps.sum())}


def test_blocks_sent_twice_corrupted_or_late_never_make_time_run_backwards(name: str) -> None:
    wrong = Misbehaviour(lose=0.02, duplicate=0.05, corrupt=0.2, stall_every_s=0.6, stall_s=0.2, seed=1)
    source = replace(EMG, name=name)
    with reading(source) as feed, running(replace(SENDER, name=name), wrong):
        wait_for(lambda: feed.count("out") > 2000 and feed.problems["stamp ran backwards"] > 0)
    assert feed.error is None
    check(source, feed)
    assert (feed.time("out") <= feed.now()).all()


def test_markers_are_events_and_what_is_cut_is_counted(name: str) -> None:
    lsl = library()
    outlet = lsl.StreamOutlet(lsl.StreamInfo(name, "Markers", 1, 0.0, "string", name))
    source = LslInlet(name=name, markers=True, text_width=8)
    texts: list[Any] = ["start", "start", "a long marker", "", "Größe", b"\xff\xfe", "end"]
    with reading(source) as feed:
        assert outlet.wait_for_consumers(5.0)
        stamp = lsl.local_clock()
        for i, text in enumerate(texts):
            outlet.push_sample([text], stamp + (i // 2) * 0.01)
        wait_for(lambda: feed.count("out") == len(texts))
    events = feed.data("out")
    assert events["text"].tolist() == ["start", "start", "a long m", "", "Größe", "\ufffd\ufffd", "end"]
    assert np.array_equal(events["onset"], feed.time("out"))
    exact = round(stamp * NS) + feed._offset + np.arange(len(texts)) // 2 * 10_000_000
    assert np.abs(feed.time("out") - exact).max() < 100_000
    assert feed.problems == {"marker cut short": 1}
    check(source, feed)


def test_silent_markers_are_waited_for_as_long_as_their_outlet_answers(name: str) -> None:
    lsl = library()
    outlet = lsl.StreamOutlet(lsl.StreamInfo(name, "Markers", 1, 0.0, "string", name))
    with reading(LslInlet(name=name, markers=True, lost_after_s=0.2)) as feed:
        assert outlet.wait_for_consumers(5.0)
        time.sleep(1.0)
        assert feed.error is None
        outlet.push_sample(["still here"])
        wait_for(lambda: feed.count("out") == 1)
        del outlet
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "has brought nothing for" in str(feed.error)


@pytest.mark.parametrize(
    ("declared", "told"),
    [
        ({"channels": ("TA", "GM", "SO", "BF")}, "its channels are TA, GM, SO, RF; declared are TA, GM, SO, BF"),
        ({"channels": 5}, "it has 4 channels, declared are 5"),
        ({"rate_hz": 500.0}, "its rate is 1000 Hz, declared is 500 Hz"),
        ({"rate_hz": 0.0}, r"its rate is 1000 Hz, declared is irregular \(0 Hz\)"),
        ({"unit": "mV"}, "its unit is 'uV'; declared is 'mV'"),
        ({"markers": True, "channels": 1}, "it holds numbers, declared are texts"),
        ({"channels": 1, "unit": "mV", "rate_hz": 20.0}, "it has 4 channels, declared are 1; its rate is 1000 Hz"),
    ],
)
def test_a_stream_that_is_not_what_was_declared_is_refused(name: str, declared: dict[str, Any], told: str) -> None:
    name = name.replace("[", "(")
    with running(replace(SENDER, name=name)), reading(replace(EMG, name=name, **declared)) as feed:
        wait_for(lambda: feed.error is not None)
    with pytest.raises(DeviceError, match=told):
        raise feed.error or AssertionError
    assert not feed.chunks


def test_a_stream_that_is_not_there_or_not_alone_is_told_with_those_that_are(name: str) -> None:
    with running(replace(SENDER, name=name, source_id="one")), running(replace(SENDER, name=name, source_id="two")):
        with reading(replace(EMG, name=f"{name}s", resolve_s=0.3)) as feed:
            wait_for(lambda: feed.error is not None)
        absent = str(feed.error)
        with reading(replace(EMG, name=name)) as feed:
            wait_for(lambda: feed.error is not None)
        assert f"no LSL stream with name '{name}s' and type 'EMG' within 0.3 s" in absent and "'one'" in absent
        assert "2 LSL streams have name" in str(feed.error) and "source_id 'two'" in str(feed.error)
        with reading(replace(EMG, name=name, source_id="two")) as feed:
            wait_for(lambda: feed.count("out") > 0)


def test_a_name_with_quotes_is_found(name: str) -> None:
    for odd in (f"{name}'s", f'{name} "quoted"', f"""{name}'s "both" & <more>"""):
        with running(replace(SENDER, name=odd)), reading(replace(EMG, name=odd)) as feed:
            wait_for(lambda: feed.count("out") > 0 or feed.error is not None)
        assert feed.error is None


def test_probe_takes_the_stream_for_what_it_is(name: str) -> None:
    with running(replace(SENDER, name=name, unit="mV", with_markers=True)):
        source = LslInlet(name=name, probe=True)
        spec = source.specs()["out"]
        assert spec.channels == MUSCLES and spec.units == ("mV",) and spec.rate_hz == 1000.0
        assert spec.meta == {"xdf_type": "EMG"} and spec.dtype == np.float64
        with reading(source.fresh()) as feed:
            wait_for(lambda: feed.count("out") > 100)
        check(source, feed)
        markers = LslInlet(name=f"{name} markers", probe=True, text_width=12).specs()["out"]
        assert markers.dtype == np.dtype([("onset", "<i8"), ("text", "<U12")])
    with running(replace(SENDER, name=name, channels=3)), reading(source.fresh()) as feed:
        wait_for(lambda: feed.error is not None)
    assert "it has 3 channels, declared are 4; has it changed since the graph was loaded?" in str(feed.error)


def test_probing_what_is_not_there_is_told_when_the_graph_is_loaded(name: str) -> None:
    text = f"nodes:\n  emg: {{use: devices.lsl.LslInlet, name: {name}, probe: true, resolve_s: 0.2}}"
    with pytest.raises(GraphError, match=rf"graph.yaml:2: node .emg.: no LSL stream with name '{name}' within 0.2 s"):
        load_text(text, path="graph.yaml")


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        ({}, "name"),
        ({"name": "x"}, "channels"),
        ({"name": "x", "channels": ["a", "a"]}, "channels"),
        ({"name": "x", "channels": 3, "unit": ["uV", "mV"]}, "unit"),
        ({"name": "x", "channels": 3, "text_width": 0, "markers": True}, "text_width"),
        ({"name": "x", "channels": 3, "network": {"scope": "house"}}, "network"),
    ],
)
def test_wrong_parameters_are_told_before_anything_is_looked_for(parameters: dict[str, Any], told: str) -> None:
    node = json.dumps({"use": "devices.lsl.LslInlet", **parameters})
    with pytest.raises(GraphError, match=told):
        load_text(f"nodes:\n  emg: {node}", path="graph.yaml")


def test_a_source_stops_while_it_is_still_looking(name: str) -> None:
    with reading(replace(EMG, name=name, resolve_s=60.0)) as feed:
        time.sleep(0.1)
    assert feed.error is None


# several at once -----------------------------------------------------------------------------------------------------


def test_several_inlets_start_together(name: str, tmp_path: Path) -> None:
    """None passes a sample on before all are there; then the streams of one walker are in step, to the sample."""
    nodes = "\n".join(
        f"  s{i}: {{use: devices.lsl.LslInlet, name: {name}{i}, channels: {list(MUSCLES)}, rate_hz: 1000}}"
        for i in range(4)
    )
    text = f"nodes:\n{nodes}\n  m: {{use: devices.lsl.LslInlet, name: {name}0 markers, markers: true}}"
    session = Session(load_text(text), tmp_path / "s", duration_s=4.0)
    late = threading.Timer(1.0, lambda: senders.append(stack(3)))
    senders: list[Any] = []

    def stack(i: int) -> Any:
        context = running(replace(SENDER, name=f"{name}{i}", source_id=f"{name}{i}", with_markers=i == 0))
        context.__enter__()
        return context

    senders += [stack(i) for i in range(3)]
    late.start()
    try:
        outcome = session.run()
    finally:
        late.join()
        for context in senders:
            context.__exit__(None, None, None)
    assert outcome.exit_code == 0, outcome.error
    with Recording.open(tmp_path / "s") as recording:
        series = [recording.read(f"s{i}") for i in range(4)]
        starts = [time[0] for time, _ in series]
        assert max(starts) - min(starts) < 0.5 * NS
        numbers = [np.round(time / 1e6).astype(np.int64) for time, _ in series]
        common = reduce(np.intersect1d, numbers)
        assert len(common) > 200
        rows = [data[np.isin(number, common)] for number, (_, data) in zip(numbers, series, strict=True)]
        assert all(np.array_equal(rows[0], other) for other in rows[1:])
        _, markers = recording.read("m")
        assert set(markers["text"].tolist()) == {"touchdown", "liftoff"}


# the outlet ----------------------------------------------------------------------------------------------------------

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
    ("outlet", "spec", "told"),
    [
        (LslOutlet("x", fields=("cause",)), EVENTS, "events: field"),
        (LslOutlet("x", events="field"), EVENTS, "one of the event's fields"),
        (LslOutlet("x", events="field", fields=("couse",)), EVENTS, "did you mean 'cause'"),
        (LslOutlet("x", events="numbers"), EVENTS, "a field that is one number"),
        (LslOutlet("x", fields=("a",)), StreamSpec((1,)), "the input is no event"),
        (LslOutlet("x"), StreamSpec((480, 640), "<u2"), "1 to 4096 numbers a sample"),
        (LslOutlet("x"), StreamSpec((2,), "<c16"), "real numbers"),
        (LslOutlet(""), StreamSpec((2,)), "a name"),
    ],
)
def test_what_cannot_go_out_is_told_when_the_graph_is_opened(outlet: LslOutlet, spec: StreamSpec, told: str) -> None:
    with pytest.raises((ParameterError, InputError), match=told):
        outlet.open({"in": spec})


def test_a_replayed_session_is_stamped_with_the_present(name: str) -> None:
    spec = StreamSpec((1,), rate_hz=1000.0)
    with opened(LslOutlet(name), spec, live=False) as (outlet, _), listening(name) as inlet:
        outlet.process("in", chunk_of(spec, np.zeros((10, 1)), 1_500_000_000 * NS))
        outlet.process("in", chunk_of(spec, np.ones((10, 1)), 1_500_000_100 * NS))
        _, stamps = pulled(inlet, 20)
    assert abs(stamps[9] - library().local_clock()) < 5.0 and stamps[10] - stamps[0] == pytest.approx(100.0, abs=1e-5)


def test_an_outlet_is_silent_in_replay(name: str, tmp_path: Path) -> None:
    from stream.engine.replay import Replay

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
    with pytest.raises(DeviceError, match="one for the whole process"), reading_of(Network(scope="global")) as feed:
        wait_for(lambda: feed.error is not None)
        raise feed.error or AssertionError


def reading_of(network: Network) -> Any:
    return reading(replace(EMG, name="nobody", network=network))
