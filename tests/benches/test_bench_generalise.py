"""Simulated people who do what people do, and the figures of each set."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from bench.generalise import Item, Tally
from bench.motion import regular
from kinegraph.devices.people.exerciser import JOINTS
from kinegraph.operators.segmentation.evaluation.found import Found
from tests.support.everyday_made import EXERCISES, RATE, Person, a_session


@pytest.mark.parametrize("seed", range(3))
def test_a_session_has_everything_in_order_and_a_foot_on_the_ground(seed: int) -> None:
    person = a_session(seed)
    joints, done = person.joints(), person.done
    assert len(joints) == round(person.time * RATE) and np.isfinite(joints).all()
    assert all(a.end <= b.start + 1e-9 for a, b in pairwise(done))
    assert all(len(d.middles) == d.count for d in done if d.kind == "exercise")
    ankles = joints[:, [JOINTS.index("ankle_l"), JOINTS.index("ankle_r")], 1].min(axis=1)
    assert ankles.min() > -0.02 and np.median(ankles) < 0.02
    thigh = np.linalg.norm(joints[:, JOINTS.index("hip_l")] - joints[:, JOINTS.index("knee_l")], axis=1)
    assert np.ptp(thigh) < 1e-3


@pytest.mark.parametrize("exercise", EXERCISES)
def test_a_half_repetition_goes_less_far(exercise: str) -> None:
    person = Person(11)
    person.exercise(exercise, 3, partial=(1,))
    assert person.done[0].ranges == (1.0, 0.4, 1.0)
    joints, starts = person.joints(), np.linspace(0, len(person.joints()) - 1, 4).astype(int)
    far = [np.ptp(joints[a:b] - joints[a:b, :1], axis=0).max() for a, b in pairwise(starts)]
    assert far[1] < max(far[0], far[2])


def test_counts_are_taken_where_an_exercise_is_and_all_of_idle_time_is_false() -> None:
    spans = np.array([[0.0, 2.0], [2.0, 4.0], [4.0, 6.0], [20.0, 21.0]])
    found = Found(np.array([[0.0, 30.0]]), np.zeros(1, bool), spans, np.zeros(4, int), np.array([1, 2, 3, 4]))
    tally = Tally()
    still = regular(np.zeros((1800, 2)))
    tally.take(Item("sets", "a", still, counts=[(0.0, 10.0, 3), (15.0, 25.0, 3)]), found)
    tally.take(Item("idle", "b", still, idle_min=2.0), found)
    assert tally.figures["sets"] == {
        "exact": [True, False],
        "within 1": [True, False],
        "MAE": [0.0, 2 / 3],
        "peaks": [False, False],
    }
    assert tally.figures["idle"]["counts a minute"] == [2.0]
    assert len({len(row) for row in tally.rows()}) == 1
