"""The thesis's batch method, which the live segmentation is compared with, finds what is there; and the bench of its speed runs."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bench import batch
from bench.missing import off_by, seen
from bench.rests import behind, counted
from kinegraph.operators.segmentation.evaluation.as_in_thesis import pairs, warped
from kinegraph.operators.segmentation.evaluation.found import Found

ROOT = Path(__file__).resolve().parents[2]


def two_actions():
    """Four cycles of 40 frames, a second's way over to elsewhere, and five cycles of 50 frames."""
    rng = np.random.default_rng(3)
    one, other = (np.arange(n * length) * 2 * np.pi / length for n, length in ((4, 40), (5, 50)))
    first = np.stack([np.cos(one), np.sin(one), np.zeros(len(one)), np.zeros(len(one))], 1)
    second = np.stack([np.zeros(len(other)), np.zeros(len(other)), 2 + np.cos(other), np.sin(other)], 1)
    way = np.linspace(first[-1], second[0], 32)[1:-1]
    return np.concatenate([first, way, second]) + 0.02 * rng.normal(size=(160 + 30 + 250, 4))


def test_the_batch_method_finds_two_actions_and_their_cycles():
    found = batch.cut(batch.distances(two_actions()), 0.1, 30)
    assert found.transition.tolist() == [False, True, False]
    assert np.abs(found.activities - [[0, 160], [160, 190], [190, 440]]).max() <= 8
    lengths = np.diff(found.primitives, axis=1)[:, 0]
    assert found.repetition.tolist() == [1, 2, 3, 4, 0, 1, 2, 3, 4, 5]
    assert np.abs(lengths[1:3] - 40).max() <= 4 and np.abs(lengths[6:9] - 50).max() <= 4


def test_shortest_paths_are_the_shortest_of_all():
    rng = np.random.default_rng(4)
    for _ in range(30):
        apart = np.where(rng.random((4, 4)) < 0.8, rng.random((4, 4)), np.inf)
        prices = [np.inf]
        for begin in range(4):
            for steps in itertools.chain(*(itertools.product([(1, 1), (1, 0), (0, 1)], repeat=n) for n in range(3, 7))):
                nodes = np.cumsum([(0, begin), *steps], axis=0)
                if nodes[-1, 0] == 3 and nodes[:, 1].max() <= 3:
                    prices.append(apart[nodes[:, 0], nodes[:, 1]].sum())
        assert np.isclose(batch.shortest_path(apart)[0], min(prices)) or min(prices) == np.inf


def test_batch_bundling_takes_noise_off_across_the_way_and_keeps_the_timing():
    turn = np.arange(1200) * 2 * np.pi / 40
    x = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1) + 0.05 * np.random.default_rng(5).normal(size=(1200, 3))
    made = batch.bundled(x)
    spread = np.linalg.norm(made[2:-2] - x[2:-2], axis=1)
    for wide in (lambda v: v[2:-2, 2].std(), lambda v: np.hypot(v[2:-2, 0], v[2:-2, 1]).std()):
        assert wide(made) < 0.6 * wide(x)
    late = np.angle(np.exp(1j * (np.arctan2(made[:, 1], made[:, 0]) - np.arctan2(x[:, 1], x[:, 0]))))
    assert spread.max() < 0.3 and np.abs(late[2:-2]).mean() < 0.02


def test_the_distance_of_two_repetitions_is_that_along_the_cheapest_path():
    a = np.array([[0.0], [1.0], [3.0]])
    assert warped(a, a) == 0.0 and warped(a, a[[0, 0, 1, 1, 2]]) == 0.0
    assert np.isclose(warped(a, a + 0.25), 0.25) and np.isclose(warped(a, np.array([[0.0], [2.0]])), (0 + 1 + 1) / 3)


def test_pairs_are_of_repetitions_of_one_cluster():
    spans = np.array([[float(i), i + 1.0] for i in range(6)])
    found = Found(spans[:1], np.array([False]), spans, np.array([0, 0, 1, -1, 1, 0]), np.array([1, 2, 1, 0, 2, 0]))
    assert pairs(found) == {0: [(0, 1)], 1: [(2, 4)]}


def test_the_bench_of_speed_runs():
    command = [sys.executable, "-m", "bench.segmentation", "--speed", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "| kinegraph, bundled: a frame, mean |" in done.stdout and "window of 15 s" in done.stdout


def test_what_is_found_behind_standing_counts_from_there():
    """A cut where the motion begins is no mistake; an activity that spans it begins with it."""
    spans = np.array([[0.0, 20.4], [20.4, 26.0], [26.0, 31.0]])
    found = Found(spans, np.zeros(3, bool), spans, np.array([-1, 0, 1]), np.array([0, 1, 1]))
    late = behind(found, 20.0)
    np.testing.assert_allclose(late.activities, [[0.4, 6.0], [6.0, 11.0]])
    assert late.cluster.tolist() == [0, 1] and len(late.boundaries()) == 1
    assert behind(found, 0.0).activities.tolist() == spans.tolist()


def test_sets_with_standing_between_are_counted_where_they_are_done():
    assert counted("wave", 1, 1.5, 1.0, 0) and counted("squat", 10, 30.0, 6.0, 1)
    assert not counted("squat", 1, 8.0, 60.0, 0), "noise beyond the motion: nothing can be counted"


def test_a_fifth_of_every_joints_values_is_lost_and_costs_no_repetition():
    joints, spans = seen(0, "a fifth of every joint's values")
    assert (
        np.isnan(joints.data).mean() == pytest.approx(0.2, abs=0.01)
        and np.isnan(joints.data).any(axis=(1, 2)).mean() > 0.95
    )
    assert len(spans) == 3 and off_by(0, "a fifth of every joint's values") == [0, 0, 0]
    assert min(off_by(0, "a fifth of every joint's values", fills=False)) > 1
