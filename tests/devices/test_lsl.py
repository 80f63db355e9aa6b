"""LSL inlets on this computer's loopback, against senders that die, come back, lose, lie, and are not what was declared."""

from __future__ import annotations

import json
import socket
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

from kinegraph.devices.lsl import LslInlet
from kinegraph.devices.lsl.discovery import find as discovered
from kinegraph.devices.lsl.network import library
from kinegraph.devices.lsl.simulator import Lsl, Sender
from kinegraph.devices.lsl.stamps import NEWEST_S
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.cli.commands.info import clocks
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError, GraphError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.devices.lsl_sender import can_be_elsewhere, process
from tests.support import SUPPORT
from tests.support.command_line import Command, kinegraph
from tests.support.device_feed import Kept, check, reading, wait_for

__all__ = ["kinegraph"]

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


@pytest.mark.skipif(not can_be_elsewhere(), reason="unshare cannot give a process another clock here (it takes root)")
@pytest.mark.parametrize("host", ["elsewhere", socket.gethostname()])
def test_the_clock_of_another_computer_is_corrected(name: str, host: str) -> None:
    """Its clock is 5000 s ahead, truly so; that it may bear this computer's name does not matter."""
    settings = {"source_id": name, "channels": list(MUSCLES)}
    with process(host, **settings), reading(replace(EMG, source_id=name)) as feed:
        wait_for(lambda: feed.count("out") > 2500 or feed.error is not None)
    assert feed.error is None and not feed.problems and not feed.lost("out")
    check(replace(EMG, source_id=name), feed)
    timing = feed.data("timing")
    ahead = (timing["device"] + feed._offset - timing["stamp"]) / NS
    assert np.abs(ahead - 5000).max() < 1e-3
    assert np.abs(np.diff(feed.time("out")) - 1_000_000).max() <= 1001, "no estimate of the clock makes a stamp leap"


@pytest.mark.skipif(not can_be_elsewhere(), reason="unshare cannot give a process another clock here (it takes root)")
def test_the_offset_of_two_computers_clocks_stands_in_the_recording(
    name: str, tmp_path: Path, kinegraph: Command
) -> None:
    """Of a computer with a clock 5000 s ahead of this one's, and of a sender here: `info` tells both, and how far they may be apart."""
    one, other = f"{name}-here", f"{name}-there"
    line = "  %s: {use: devices.lsl.LslInlet, source_id: %s, channels: 4, rate_hz: 1000, unit: uV, type: EMG}\n"
    graph = load_text("nodes:\n" + line % ("here", one) + line % ("there", other))
    settings = {"channels": list(MUSCLES), "rate_hz": 1000}
    with process(source_id=one, **settings), process("elsewhere", source_id=other, **settings):
        outcome = Session(graph, tmp_path / "s", duration_s=4).run()
    assert outcome.error is None
    with Recording.open(tmp_path / "s") as recording:
        known = clocks(recording)
    ahead = known["here"]["offset_s"] - known["there"]["offset_s"]
    assert abs(ahead - 5000) < 0.01 and all(0 < clock["uncertainty_s"] < 0.1 for clock in known.values())
    _, shown, _ = kinegraph("info", str(tmp_path / "s"))
    assert (
        "here and there agree within" in shown or "there and here agree within" in shown
    ) and "clock there: within" in shown


def test_a_sender_that_is_killed_and_started_again_is_found_and_the_loss_marked(name: str) -> None:
    source, settings = replace(EMG, name=name, lost_after_s=30.0), {"name": name, "channels": list(MUSCLES)}
    with process(**settings) as first, reading(source) as feed:
        wait_for(lambda: feed.count("out") > 500)
        first.kill()
        before = feed.count("out")
        with process(**settings):
            wait_for(lambda: feed.count("out") > before + 500)
    assert feed.error is None and feed.problems == {"reconnected": 1, "gap": 1}
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
    session = Session(load_text(text, path=str(SUPPORT / "graph.yaml")), tmp_path / "s")
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
        assert len(failed) == 1 and "has delivered nothing for" in failed[0]["error"]
        assert recording.streams["clock"].gaps == 0, "the rest of the graph went on"


def samples(name: str) -> int:
    return sum(len(c) for c in parts.seen.get(name, ()))


@contextmanager
def running(sender: Lsl, faults: FaultInjection | None = None) -> Iterator[Sender]:
    with sender.sending(faults or FaultInjection()) as at_work:
        yield at_work


def test_lost_blocks_of_an_even_sender_are_counted(name: str) -> None:
    sender, wrong = replace(SENDER, name=name, source_id=name), FaultInjection(lose=0.1, from_s=2.5, seed=2)
    with reading(replace(EMG, source_id=name)) as feed, running(sender, wrong) as at_work:
        wait_for(lambda: at_work.injector.lost > 5 and feed.count("out") > 3000)
    number = assert_exact(feed, sender)
    leaps = np.diff(number) - 1
    assert feed.lost("out") == {int(i) + 1: int(leaps[i]) for i in np.flatnonzero(leaps)}
    assert feed.problems == {"lost sample": int(leaps.sum())}


def test_blocks_sent_twice_corrupted_or_late_never_make_time_run_backwards(name: str) -> None:
    wrong = FaultInjection(lose=0.02, duplicate=0.05, corrupt=0.2, stall_every_s=0.6, stall_s=0.2, seed=1)
    source = replace(EMG, source_id=name)
    with reading(source) as feed, running(replace(SENDER, source_id=name), wrong):
        wait_for(lambda: feed.error or (feed.count("out") > 2000 and feed.problems["stamp ran backwards"] > 0))
    assert feed.error is None
    check(source, feed)
    assert (feed.time("out") <= feed.now() + NEWEST_S * NS).all()


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
    assert isinstance(feed.error, DeviceError) and "has delivered nothing for" in str(feed.error)


@pytest.mark.parametrize(
    ("declared", "message"),
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
def test_a_stream_that_is_not_what_was_declared_is_refused(name: str, declared: dict[str, Any], message: str) -> None:
    name = name.replace("[", "(")
    with running(replace(SENDER, source_id=name)), reading(replace(EMG, source_id=name, **declared)) as feed:
        wait_for(lambda: feed.error is not None)
    with pytest.raises(DeviceError, match=message):
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
        with reading(source.unopened()) as feed:
            wait_for(lambda: feed.count("out") > 100)
        check(source, feed)
        markers = LslInlet(name=f"{name} markers", probe=True, text_width=12).specs()["out"]
        assert markers.dtype == np.dtype([("onset", "<i8"), ("text", "<U12")])
    with running(replace(SENDER, name=name, channels=3)), reading(source.unopened()) as feed:
        wait_for(lambda: feed.error is not None)
    assert "it has 3 channels, declared are 4; has it changed since the graph was loaded?" in str(feed.error)


def test_probing_what_is_not_there_is_told_when_the_graph_is_loaded(name: str) -> None:
    text = f"nodes:\n  emg: {{use: devices.lsl.LslInlet, name: {name}, probe: true, resolve_s: 0.2}}"
    with pytest.raises(GraphError, match=rf"graph.yaml:2: node .emg.: no LSL stream with name '{name}' within 0.2 s"):
        load_text(text, path="graph.yaml")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "name"),
        ({"name": "x"}, "channels"),
        ({"name": "x", "channels": ["a", "a"]}, "channels"),
        ({"name": "x", "channels": 3, "unit": ["uV", "mV"]}, "unit"),
        ({"name": "x", "channels": 3, "text_width": 0, "markers": True}, "text_width"),
        ({"name": "x", "channels": 3, "network": {"scope": "house"}}, "network"),
    ],
)
def test_wrong_parameters_are_told_before_anything_is_looked_for(parameters: dict[str, Any], message: str) -> None:
    node = json.dumps({"use": "devices.lsl.LslInlet", **parameters})
    with pytest.raises(GraphError, match=message):
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
    session = Session(load_text(text), tmp_path / "s", duration_s=8.0)
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


def test_the_listed_yaml_reads_the_stream_that_was_found(name: str) -> None:
    with running(replace(SENDER, name=name, source_id=name, rate_hz=1000 / 3, with_markers=True)):
        listed = {found.address: found for found in discovered()}
        text = "nodes:\n" + "".join(
            f"  {node}:\n" + "".join(f"    {line}\n" for line in listed[stream].yaml.splitlines())
            for node, stream in (("emg", name), ("markers", f"{name} markers"))
        )
        for node in load_text(text).sources:
            if isinstance(node.part, LslInlet):
                with reading(node.part) as feed:
                    wait_for(lambda feed=feed: feed.count("out") > 1 or feed.error is not None)  # type: ignore[misc]
                assert feed.error is None
    assert "EMG: 4 channels float32, at 333.333333333 Hz, on " in listed[name].what
