"""The benches of mixtures and steps run, and their plain contenders compute the same."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from bench.gait import Cycles, plain_distance, plain_features, section, walkers
from bench.mixtures import alarms
from kinegraph.operators.emg.mixtures.distance import cauchy_schwarz
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.operators.steps.step_kernel import COUNT, describe

pytest.importorskip("sklearn", reason="scikit-learn is not installed")


def test_ours_and_theirs_stand_in_one_table():
    made = section(0.002, 1)
    tasks = " ".join(row[0] for row in made.rows)
    assert all(name in tasks for name in ("refit, TA", "divergence", "50 features", "forest"))
    assert [goal.limit for goal in made.goals] == [1.0, 3.0, 25.0]
    assert all(float(row[1]) > 0 for row in made.rows)


def test_the_plain_contenders_compute_the_same():
    _, _, window = walkers(1)
    out = np.empty(COUNT)
    describe(window, 100.0, True, np.empty((6, len(window))), out)
    np.testing.assert_allclose(out, plain_features(window, 100.0), atol=1e-9)
    mine = tuple(part.copy() for part in Cycles("TA").fit(PeakMixtures(circular=False).fitting()))
    other = mine[0], mine[1] + 1.0, mine[2]
    distances = [call() for call in (partial(plain_distance, mine, other), partial(cauchy_schwarz, *mine, *other, 0))]
    assert distances[0] == pytest.approx(distances[1], rel=1e-9)


def test_drift_is_tried_with_a_parameters_neighbours(capsys):
    alarms(0.1, [1], ["TA"], cycles=4)
    assert "TA: false alarms [0] by seed" in capsys.readouterr().out
