"""Sessions in which something fails: operators, outlets, lanes, signals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import parts
import pytest
from structlog.testing import capture_logs

from kinegraph.stream.chunk import NS, Chunk, empty
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.errors import RunError
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.reading.load import load_text
from tests.engine.session_runs import clean as clean
from tests.engine.session_runs import recorded, run, session_of
from tests.support import SUPPORT


def test_an_operator_that_raises_stops_the_graph_and_leaves_the_recording_readable(tmp_path: Path) -> None:
    nodes = """
  board: {use: parts.Counting, samples: 5000}
  sum: {use: parts.RunningSum, from: board, fails_at: 1234}
"""
    outcome = run(nodes, tmp_path / "s", "record: [sum]")
    assert isinstance(outcome.error, RunError)
    assert outcome.exit_code == 4
    reported = str(outcome.error)
    assert "node 'sum': ValueError: this number is not to my taste" in reported
    assert "parts.py, line" in reported and "at sample time 2023-11-14T22:13:21.23" in reported
    recording = recorded(tmp_path / "s")
    assert recording.finished
    assert recording.streams["sum"].samples == 1230
    assert recording.streams["board"].samples >= 1240


def test_an_outlet_that_fails_is_switched_off_and_the_graph_goes_on() -> None:
    nodes = """
  board: {use: parts.Counting, samples: 3000}
  bad: {use: parts.Collect, from: board, name: bad, fails_after: 100}
  out: {use: parts.Collect, from: board}
"""
    outcome = run(nodes)
    assert outcome.exit_code == 5
    error = outcome.table["bad"]["error"]
    assert error.startswith("OSError: the network is down (") and "parts.py, line " in error
    assert parts.numbers() == list(range(3000))
    assert len(parts.numbers("bad")) == 100


def test_a_slow_outlet_loses_its_own_data_and_never_the_graphs() -> None:
    nodes = """
  board: {use: parts.Counting, samples: 1500, realtime: true, chunk: 5}
  slow: {use: parts.Collect, from: board, name: slow, slow_s: 0.05, queue: 4, worker: slow}
  out: {use: parts.Collect, from: board}
"""
    outcome = run(nodes)
    assert outcome.exit_code == 5 and list(outcome.missing) == ["slow"]
    assert parts.numbers() == list(range(1500))
    assert outcome.table["slow"]["dropped"] > 100
    assert len(parts.numbers("slow")) + outcome.table["slow"]["dropped"] == 1500


def test_a_lane_changes_nothing_but_the_thread() -> None:
    nodes = """
  board: {use: parts.Counting, samples: 3000, chunk: 11}
  aside: {use: parts.RunningSum, from: board, worker: side}
  here: {use: parts.RunningSum, from: board}
  both: {use: parts.Beside, from: {a: aside, b: here}}
  out: {use: parts.Collect, from: both}
"""
    outcome = run(nodes)
    assert outcome.error is None
    got = parts.numbers()
    assert got[0::2] == got[1::2]
    assert len(got) == 6000


def test_an_error_on_a_lane_stops_the_graph_with_the_nodes_name() -> None:
    nodes = """
  board: {use: parts.Counting, samples: 5000, realtime: true}
  sum: {use: parts.RunningSum, from: board, fails_at: 200, worker: side}
"""
    outcome = run(nodes)
    assert outcome.exit_code == 4
    assert "node 'sum'" in str(outcome.error)


def test_annotations_and_values_are_recorded_streams(tmp_path: Path) -> None:
    nodes = """
  board: {use: parts.Counting, samples: 100000, realtime: true}
  volume: {use: stream.manual.Value, initial: 1.0, least: 0, most: 10}
  loud: {use: parts.Gain, from: {signal: board, gain: volume}}
  out: {use: parts.Collect, from: loud}
"""
    session = session_of(nodes, tmp_path / "s", "record: [loud]")

    def person() -> None:
        while not parts.numbers():
            time.sleep(0.05)
        time.sleep(0.3)
        session.tell("volume", "3.5")
        session.mark("coughed")
        time.sleep(0.4)
        session.stop()

    thread = threading.Thread(target=person)
    thread.start()
    outcome = session.run()
    thread.join()
    assert outcome.error is None
    recording = recorded(tmp_path / "s")
    assert recording.read("annotations")[1]["text"].tolist() == ["coughed"]
    assert recording.read("volume")[1][:, 0].tolist() == [1.0, 3.5]
    factors = {
        round(float(r[1] / r[0]), 6) for c in parts.seen["out"] for r in zip(range(1, 10), range(1, 10), strict=True)
    }
    assert factors == {1.0}


TEN_YEARS_MS = 3.2e11


@pytest.mark.parametrize("offset_ms", [0.0, TEN_YEARS_MS], ids=["data of years ago", "data that outrun the clock"])
def test_where_no_source_is_live_people_s_words_follow_the_data(offset_ms: float, tmp_path: Path) -> None:
    """Nothing waits for the clock: 300 s of data have gone through while the source still stands, all but the last 50 ms."""
    nodes = f"""
  board: {{use: parts.Counting, samples: 310000, chunk: 100, trouble: pauses, at: 300000, pause_s: 1.5, offset_ms: {offset_ms}}}
  volume: {{use: stream.manual.Value, initial: 2}}
  loud: {{use: parts.Gain, from: {{signal: board, gain: volume}}}}
  out: {{use: parts.Collect, from: loud, policy: block}}
"""
    session = session_of(nodes, tmp_path / "s", "record: [loud]")
    came: list[int] = []
    now: list[int] = []

    def person() -> None:
        deadline = time.monotonic() + 60
        while len(parts.numbers()) < 299_900 and time.monotonic() < deadline:
            time.sleep(0.05)
        came.append(len(parts.numbers()))
        now.append(session.now())
        session.tell("volume", "3")
        session.mark("coughed")

    thread = threading.Thread(target=person)
    thread.start()
    with capture_logs() as entries:
        outcome = session.run()
    thread.join()
    assert not [entry for entry in entries if entry["log_level"] == "warning"]
    assert outcome.error is None and 299_900 <= came[0] <= 300_000
    last = parts.START + int(offset_ms * 1e6) + 300 * NS
    assert abs(now[0] - last) < NS // 10
    recording = recorded(tmp_path / "s")
    values, words = recording.read("volume"), recording.read("annotations")
    assert values[1][:, 0].tolist() == [2, 3] and words[1]["text"].tolist() == ["coughed"]
    assert values[0][0] < recording.read("board")[0][0], "a value is there before the first sample"
    for stamp in (values[0][1], words[0][0], words[1]["onset"][0]):
        assert abs(int(stamp) - last) < NS // 10
    loud, board = recording.read("loud")[1], recording.read("board")[1]
    np.testing.assert_array_equal(loud[:300_000], 2 * board[:300_000])
    np.testing.assert_array_equal(loud[-1], 3 * board[-1])


def test_what_is_said_before_the_data_waits_for_them(tmp_path: Path) -> None:
    """Several words, each with a stamp of its own before the first sample; without any data, they are recorded all the same."""
    for samples, name in ((10, "some"), (0, "none")):
        session = session_of(f"  board: {{use: parts.Counting, samples: {samples}}}", tmp_path / name)
        session.mark("one")
        session.mark("two")
        assert session.run().exit_code == 0
        stamps, words = recorded(tmp_path / name).read("annotations")
        assert words["text"].tolist() == ["one", "two"] and stamps[0] < stamps[1]
        assert not samples or stamps[1] < parts.START


def test_a_session_is_whole_before_it_runs(tmp_path: Path) -> None:
    """What is typed before `run` is there when it begins, and making a session opens nothing."""
    before = parts.threads()
    session = session_of("  board: {use: parts.Counting}", tmp_path / "s")
    assert session.in_hand() is None and parts.threads() == before and not (tmp_path / "s").exists()
    session.mark("ready")
    assert session.run().exit_code == 0
    assert recorded(tmp_path / "s").read("annotations")[1]["text"].tolist() == ["ready"]


def test_a_row_of_500_operators_runs(tmp_path: Path) -> None:
    """Also what a segment leaves to be carried step by step: a gap, and the end."""
    nodes = "  board: {use: parts.Counting, realtime: true, samples: 300, trouble: dies, at: 100}\n"
    for i in range(500):
        nodes += f"  n{i}: {{use: parts.Identity, from: {f'n{i - 1}' if i else 'board'}}}\n"
    outcome = session_of(nodes + "  out: {use: parts.Collect, from: n499, policy: block}").run()
    assert outcome.error is None and parts.numbers() == list(range(300)) and parts.lost() == [-1]


def test_a_value_out_of_bounds_is_refused_with_its_bounds() -> None:
    session = session_of("  board: {use: parts.Counting}\n  volume: {use: stream.manual.Value, initial: 1, most: 2}")
    with pytest.raises(Exception, match=r"value is 3\.0; it must be between -1e\+308 and 2"):
        session.tell("volume", "3")
    with pytest.raises(Exception, match="there is no source 'nobody'"):
        session.tell("nobody", "3")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_session_cleanly(number: int, tmp_path: Path) -> None:
    graph = SUPPORT / f"signal-{number}.yaml"
    config = tmp_path / "graph.yaml"
    config.write_text("nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n")
    assert not graph.exists()
    folder = tmp_path / "s"
    process = subprocess.Popen(
        [sys.executable, "-m", "kinegraph", "run", str(config), "-o", str(folder), "--view", "none"],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not list(folder.glob("*.mcap")) and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(1.0)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    recording = recorded(folder)
    assert recording.finished
    assert recording.streams["board.emg"].samples > 100
    asked = [entry["by"] for entry in recording.log if entry["kind"] == "asked to end"]
    assert asked == [signal.Signals(number).name] and "asked to end" in errors


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
@pytest.mark.parametrize("sent", ["SIGTERM", "SIGHUP"])
def test_a_session_whose_log_nobody_reads_any_more_ends_all_the_same(sent: str, tmp_path: Path) -> None:
    """As behind a terminal that was closed: the report of the signal cannot be written."""
    config, folder = tmp_path / "graph.yaml", tmp_path / "s"
    config.write_text("nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n")
    process = subprocess.Popen(
        [sys.executable, "-m", "kinegraph", "run", str(config), "-o", str(folder), "--view", "none"],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60
        while not list(folder.glob("*.mcap")) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)
        assert process.stdout and process.stderr
        process.stdout.close()
        process.stderr.close()
        process.send_signal(getattr(signal, sent))
        process.wait(30)
    finally:
        process.kill()
        process.wait(30)
    recording = recorded(folder)
    assert recording.finished and recording.streams["board.emg"].samples > 100
    assert [entry["by"] for entry in recording.log if entry["kind"] == "asked to end"] == [sent]


def test_a_source_that_floods_waits_and_loses_nothing() -> None:
    nodes = """
  hose: {use: parts.Counting, samples: 200000, chunk: 3, queue: 8}
  out: {use: parts.Collect, from: hose}
"""
    outcome = run(nodes)
    assert outcome.error is None
    assert parts.numbers() == list(range(200000))


def test_two_drifting_sources_keep_their_order_through_a_minute_of_silence() -> None:
    """An hour's worth of drift at 50 ppm in the stamps; the second source says nothing for a minute, as its supervisor would tell."""
    graph = load_text(
        "nodes:\n  a: {use: parts.Counting}\n  b: {use: parts.Counting}\n"
        "  both: {use: parts.Beside, from: {a: a, b: b}}\n  out: {use: parts.Collect, from: both}",
        path=str(SUPPORT / "graph.yaml"),
    )
    pipeline = Pipeline(graph, speaking={"out"})
    held = []
    for second in range(120):
        for stream, rate in (("a", 100.0), ("b", 100.0 * (1 + 50e-6))):
            index = np.arange(second * 100, second * 100 + 100)
            times = parts.START + np.round(index * 1e9 / rate).astype(np.int64)
            if stream == "b" and 30 <= second < 90:
                pipeline.feed("b", empty(graph.nodes["b"].specs["out"], int(times[-1])))
            else:
                lost = -1 if stream == "b" and second == 90 else 0
                pipeline.feed(stream, Chunk(times, np.stack([index, index], axis=1) * 1.0, int(times[-1]), lost))
        merge = pipeline.stages["both"].merge
        assert merge
        held.append(merge.held)
    times = np.concatenate([c.time for c in parts.seen["out"]])
    assert (np.diff(times) >= 0).all()
    assert max(held) <= 2
    assert len(times) == 100 * (120 + 60) - merge_tail(graph, pipeline)
    assert parts.lost() == [-1]


def merge_tail(graph: Graph, pipeline: Pipeline) -> int:
    """How many samples still wait for the other source."""
    before = sum(len(c) for c in parts.seen["out"])
    for name in ("a", "b"):
        pipeline.end(name)
    return sum(len(c) for c in parts.seen["out"]) - before
