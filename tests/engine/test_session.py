"""Live sessions: order and loss, supervision, workers, the common start, a clean end in every case."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import parts
import pytest
from structlog.testing import capture_logs

from kinegraph.stream.engine import session_log
from kinegraph.stream.errors import DeviceError, GraphError, RecordingError
from kinegraph.stream.recording.format.checkpoint import NAME as CHECKPOINT
from kinegraph.stream.source import Feed
from tests.engine.session_runs import clean as clean
from tests.engine.session_runs import recorded, run, session_of

CHAIN = """
  board: {use: parts.Counting, samples: 5000, chunk: 7 %s}
  same: {use: parts.Identity, from: board}
  out: {use: parts.Collect, from: same}
"""


def test_every_sample_arrives_once_and_in_order() -> None:
    outcome = run(CHAIN % "")
    assert outcome.exit_code == 0, outcome.error
    assert parts.numbers() == list(range(5000))
    assert parts.lost() == []
    assert outcome.compiled == []


def test_all_threads_end() -> None:
    before = parts.threads()
    run(CHAIN % "")
    assert parts.threads() <= before


def test_a_slip_in_ones_own_operator_is_told_with_both_lines() -> None:
    nodes = """
  board: {use: parts.Counting, samples: 100}
  mine: {use: parts.Misspelt, from: board}
"""
    with pytest.raises(
        GraphError, match=r"graph.yaml:5: node 'mine': .*'Chunk' object has no attribute 'dat' \(.*parts.py, line \d+\)"
    ):
        run(nodes)


def test_a_session_that_is_refused_leaves_no_thread(tmp_path: Path) -> None:
    before = parts.threads()
    run(CHAIN % "", tmp_path / "s")
    with pytest.raises(RecordingError, match="already holds a recording"):
        run(CHAIN % "", tmp_path / "s")
    assert parts.threads() <= before


@pytest.mark.parametrize("slow", [False, True])
def test_the_recording_is_on_the_disk_before_the_first_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slow: bool
) -> None:
    """With what a resumed session would begin from; but a disk that is slow does not hold up the start."""
    folder, there = tmp_path / "s", []
    read, sync = parts.Counting.read, os.fsync

    def noted(board: parts.Counting, feed: Feed) -> None:
        there.append((folder / CHECKPOINT).exists())
        read(board, feed)

    monkeypatch.setattr(parts.Counting, "read", noted)

    def slowly(file: int) -> None:
        time.sleep(2.0)
        sync(file)

    if slow:
        monkeypatch.setattr(os, "fsync", slowly)
    else:
        monkeypatch.setattr(session_log, "SETTLE_S", 30.0)  # the test's machine may be busy
    assert run(CHAIN % "", folder).exit_code == 0
    assert there == [not slow]
    assert recorded(folder).streams["board"].samples == 5000


def test_a_queue_that_drops_counts_and_marks_every_sample(tmp_path: Path) -> None:
    nodes = """
  board: {use: parts.Counting, samples: 2000, realtime: true, chunk: 10, queue: 3, policy: drop_oldest}
  slow: {use: parts.RunningSum, from: board, slow_s: 0.03}
  out: {use: parts.Collect, from: board, policy: block}
"""
    outcome = run(nodes, tmp_path / "s")
    assert outcome.exit_code == 5 and list(outcome.missing) == ["board"]
    got = parts.numbers()
    assert got == sorted(set(got))
    assert len(got) < 2000
    assert len(got) + sum(parts.lost()) == 2000 or got[0] > 0
    assert outcome.table["board"]["dropped"] == 2000 - len(got)
    log = recorded(tmp_path / "s").log
    assert sum(e["samples"] for e in log if e["kind"] == "source queue dropped") == 2000 - len(got)


def test_a_queue_that_must_not_fill_fails_the_source() -> None:
    nodes = """
  board: {use: parts.Counting, samples: 500, chunk: 1, queue: 2, policy: fail, realtime: true}
  slow: {use: parts.RunningSum, from: board, slow_s: 0.02}
"""
    outcome = run(nodes, duration_s=1.0)
    assert outcome.exit_code == 4
    assert "queue of board is full" in str(outcome.error)


@pytest.mark.parametrize("trouble", ["dies", "hangs"])
def test_a_source_that_fails_is_opened_again_and_the_gap_is_marked(trouble: str, tmp_path: Path) -> None:
    nodes = f"""
  board: {{use: parts.Counting, samples: 1500, realtime: true, trouble: {trouble}, silence_s: 0.4, key: one}}
  other: {{use: parts.Counting, samples: 2200, realtime: true, key: two}}
  out: {{use: parts.Collect, from: board}}
  beside: {{use: parts.Collect, from: other, name: beside}}
"""
    outcome = run(nodes, tmp_path / "s")
    assert outcome.exit_code == 0, outcome.error
    assert parts.openings == {"one": 2, "two": 1}
    assert parts.lost() == [-1]
    first, beside = parts.numbers(), parts.numbers("beside")
    assert first == list(range(first[0], 1500))
    assert beside == list(range(beside[0], 2200))
    assert min(first[0], beside[0]) == 0
    assert parts.lost("beside") == []
    kinds = [e["kind"] for e in recorded(tmp_path / "s").log]
    assert "source failed" in kinds
    assert "source reopened" in kinds


def test_a_required_source_that_never_starts_ends_the_run_with_its_name() -> None:
    nodes = "  bed: {use: parts.Silent, deadline_s: 0.3}\n" + CHAIN % ", realtime: true"
    outcome = run(nodes)
    assert isinstance(outcome.error, DeviceError)
    assert outcome.exit_code == 3
    assert "'bed' delivered nothing within 0.3 s" in str(outcome.error)
    assert parts.numbers() == []


def test_a_source_that_is_not_required_may_be_missing() -> None:
    nodes = (
        "  bed: {use: parts.Silent, required: false}\n  foot: {use: devices.mti.Mti, port: /dev/ttyGONE, required: false}\n"
        + CHAIN % ""
    )
    session = session_of(nodes.replace("use: parts.Collect,", "use: parts.Collect, policy: block,"))

    def stop_when_all_came() -> None:
        deadline = time.monotonic() + 60
        while len(parts.numbers()) < 5000 and time.monotonic() < deadline:
            time.sleep(0.05)
        session.stop()

    watcher = threading.Thread(target=stop_when_all_came)
    watcher.start()
    outcome = session.run()
    watcher.join()
    assert parts.numbers() == list(range(5000))
    assert outcome.error is None and outcome.exit_code == 0
    assert outcome.table["foot.imu"]["error"], "it stays visible that it is missing"


def test_a_silent_source_does_not_stop_a_merge_and_what_comes_late_is_dropped(tmp_path: Path) -> None:
    nodes = """
  one: {use: parts.Counting, samples: 2500, realtime: true, key: one}
  two: {use: parts.Counting, samples: 1000, realtime: true, trouble: pauses, pause_s: 1.5, at: 300, patience_s: 0.3, stale_s: 0.2, key: two}
  both: {use: parts.Beside, from: {a: one, b: two}}
  out: {use: parts.Collect, from: both}
"""
    outcome = run(nodes, tmp_path / "s", "record: [both]")
    assert outcome.error is None
    times = [t for c in parts.seen["out"] for t in c.time]
    assert times == sorted(times)
    assert outcome.table["two"]["late"] > 500
    kinds = {e["kind"] for e in recorded(tmp_path / "s").log}
    assert {"silent source advanced", "stream is stale", "late samples dropped"} <= kinds


@pytest.mark.parametrize(
    ("slip", "kind", "message"),
    [
        ("another output", "source failed", "an output 'egm' that it does not have: did you mean 'emg'"),
        ("a type", "source failed", "parts.py, line "),
        ("seconds", "late samples dropped", "nanoseconds since 1970"),
        ("local time", "finding", "stamps 3600.0 s ahead"),
    ],
)
def test_a_slip_in_ones_own_source_is_told(slip: str, kind: str, message: str, tmp_path: Path) -> None:
    nodes = f"  own: {{use: parts.Slips, slip: {slip}}}\n  out: {{use: parts.Collect, from: own.emg}}\n"
    run(nodes, tmp_path / "s", duration_s=1.0)
    assert any(message in str(entry) for entry in recorded(tmp_path / "s").log if entry["kind"] == kind)


def test_losses_with_every_chunk_are_told_once_and_all_recorded(tmp_path: Path) -> None:
    nodes = "  own: {use: parts.Slips, slip: seconds}\n  out: {use: parts.Collect, from: own.emg}\n"
    with capture_logs() as entries:
        run(nodes, tmp_path / "s", duration_s=1.0)
    losses = [entry for entry in entries if entry["event"] == "late samples dropped"]
    kept = [entry for entry in recorded(tmp_path / "s").log if entry["kind"] == "late samples dropped"]
    assert len(kept) > len(losses) == 2  # at once, and the rest at the end
    assert sum(entry["samples"] for entry in losses) == sum(entry["samples"] for entry in kept)
    assert losses[1]["times"] == len(kept) - 1
