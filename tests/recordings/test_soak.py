"""The soak in small: its ledger finds what is missing and what is too much, and a session under every fault balances."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.graph import Edge
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.reading.overrides import read
from kinegraph.stream.source import Source
from tests.soak.faults import KINDS, drawn
from tests.soak.growth import growth
from tests.soak.happening import soak
from tests.soak.judge import judge
from tests.soak.ledger import Ledger, by_stamps, mended
from tests.soak.uses import CONFIGS, USES, Use
from tests.soak.watched import Held, Watched

OFFERED = np.arange(10)


def ledger(index: list[int], lost: dict[int, int]) -> Ledger:
    """Of these recorded indices, with these marks before the samples at these places."""
    marks = np.zeros(len(index), np.int64)
    for at, count in lost.items():
        marks[at] = count
    return Ledger.of(np.array(index, np.int64), marks)


def test_everything_recorded_balances() -> None:
    assert Ledger.of(OFFERED, np.zeros(10, np.int64)) == Ledger(offered=10, recorded=10)
    assert Ledger.of(OFFERED, np.zeros(10, np.int64)).balanced


def test_what_is_marked_as_missing_balances() -> None:
    found = ledger([0, 1, 4, 5, 9], {2: 2, 4: -1})
    assert found == Ledger(offered=10, recorded=5, counted=2, uncounted=3)
    assert found.balanced


@pytest.mark.parametrize(
    ("index", "lost", "wrong"),
    [
        ([0, 1, 4], {}, {"silent": 2}),
        ([0, 1, 4], {2: 1}, {"silent": 1}),
        ([0, 1, 4], {2: 3}, {"invented": 1}),
        ([0, 1, 2], {1: 4}, {"invented": 4}),
        ([0, 1, 1, 2], {}, {"twice": 1}),
        ([0, 2, 1, 3], {1: 1, 3: 1}, {"twice": 1}),
    ],
)
def test_what_does_not_balance_is_found(index: list[int], lost: dict[int, int], wrong: dict[str, int]) -> None:
    found = ledger(index, lost)
    assert not found.balanced
    assert {name: getattr(found, name) for name in wrong} == wrong


def test_stamps_on_a_grid_give_indices_and_a_gap_of_unknown_size_counts_as_none() -> None:
    times = np.array([0, 10, 40, 50, 7_000_003, 7_000_013], np.int64) * 1_000_000
    lost = np.array([0, 0, 2, 0, -1, 0], np.int64)
    index = by_stamps(times, lost, 100.0)
    assert index.tolist() == [0, 1, 4, 5, 6, 7]
    assert Ledger.of(index, lost).balanced


def test_damaged_digits_are_counted_and_no_sample_is_made_up_by_them() -> None:
    index = np.array([0, 1, 212_002_003, 3, 4, 123_456_789, 8], np.int64)
    lost = np.array([0, 0, 0, 0, 0, 2, 0], np.int64)
    whole, damaged = mended(index, lost, 100)
    assert whole.tolist() == [0, 1, 2, 3, 4, 7, 8] and damaged == 2
    assert Ledger.of(whole, lost).balanced


def test_the_same_seed_draws_the_same_faults_and_every_kind_happens() -> None:
    faults = drawn(3, 600, ("a", "b"))
    assert faults == drawn(3, 600, ("a", "b")) != drawn(4, 600, ("a", "b"))
    assert {fault.kind for fault in faults} == set(KINDS)
    assert all(fault.at_s >= 15 and fault.at_s + fault.for_s <= 585 for fault in faults)


@pytest.mark.parametrize("use", USES, ids=lambda use: use.name)
def test_every_use_can_be_run_for_so_many_hours_as_fast_as_it_goes(use: Use, tmp_path: Path) -> None:
    hours = [one.format(hours=2.0, seconds=7200.0) for one in use.hours]
    graph = load(CONFIGS / use.config, overrides=read(hours))
    sources = [source for source in graph.parts(Source) if not source.background]
    assert sources and not any(source.live for source in sources)
    live = load(use.write(tmp_path, "/dev/null", 1883), overrides=read(list(use.live)))
    assert all(source.live for source in live.parts(Source))
    assert set(use.regular) <= {
        str(Edge(n.name, output)) for n in live.sources for output, spec in n.specs.items() if spec.rate_hz
    }


@pytest.mark.parametrize(("leak", "expected"), [(0, 0), (1, 1)])
def test_a_file_that_stays_open_is_a_leak_and_one_for_a_moment_is_none(leak: int, expected: int) -> None:
    looks = [Held(1000, 10 + (i == 900) + leak * (i > 700), 9) for i in range(1000)]
    assert len(growth(USES[0], looks, 1.0, 0).complaints) == expected


def test_a_page_whose_session_was_killed_says_nothing_of_it() -> None:
    """Killed between a message to the page's server and its answer: a traceback stood in the log."""
    code = "import sys; from kinegraph.devices.page.server import say; say({'do': 'want'}); print('went on', file=sys.stderr)"
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "went on\n")


@pytest.mark.timeout(400)
@pytest.mark.xdist_group("load")
@pytest.mark.nightly
def test_a_session_under_every_fault_loses_nothing_silently(tmp_path: Path) -> None:
    seconds = 40.0
    faults = drawn(6, seconds, ("treadmill",), quiet_s=4.0, pace=6.0)
    watched = Watched(USES[0], tmp_path / "treadmill")
    try:
        watched.start()
        done = soak([watched], faults, seconds)
    finally:
        watched.close()
    assert {"kill", "unplug", "full disk", "suspend"} <= set(done)
    judged = judge(watched)
    assert not judged.complaints
    assert judged.ledgers["lines"].counted > 0, "single lines were lost on the way"
