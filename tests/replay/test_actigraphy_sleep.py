"""configs/actigraphy_sleep.yaml: sleep and wake, epoch by epoch, from a wrist actigraph, and the night's numbers.

Recording: a real night's hypnogram from polysomnography (Walch 2019; PhysioNet). Recordings of actigraphs that may be kept were not found,
so that the counts are made along the hypnogram: many in most epochs awake, few in some asleep.
Truth: Oakley's weighted sum as printed, by numpy; sleep time and the like counted from the scores by hand; the hypnogram itself.
"""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.metrics import cohen_kappa_score

import kinegraph as kg
from kinegraph.stream.chunk import NS, Array
from tests.replay.replaying import signal
from tests.support.real import real_arrays

EPOCH_S = 30.0
ASLEEP = real_arrays("sleep/psg_hypnograms_walch2019.npz")["subj00_stage"] > 0
NIGHT = len(ASLEEP)
OUTSIDE = 40
"""Epochs before lights off and after lights on, awake."""
WEIGHTS = np.array([0.04, 0.04, 0.20, 0.20, 2.00, 0.20, 0.20, 0.04, 0.04])


def counts() -> Array:
    random = np.random.default_rng(3)
    asleep = np.concatenate([np.zeros(OUTSIDE, bool), ASLEEP, np.zeros(OUTSIDE, bool)])
    awake = np.where(random.random(len(asleep)) < 0.8, random.gamma(2.0, 60.0, len(asleep)), 0.0)
    quiet = np.where(random.random(len(asleep)) < 0.06, random.gamma(1.0, 10.0, len(asleep)), 0.0)
    return np.rint(np.where(asleep, quiet, awake))


COUNTS = counts()


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    graph = kg.load("actigraphy_sleep")
    pressed = np.array([OUTSIDE, OUTSIDE + NIGHT]) * round(EPOCH_S * NS)
    lights = kg.Series("", graph.specs["actigraph.lights"], pressed, np.array([(False,), (True,)], [("on", "?")]))
    activity = signal(
        COUNTS[:, None], 1 / EPOCH_S, ["wrist"], ["counts"], device="actiwatch", site="wrist", epoch_s=EPOCH_S
    )
    return graph.run({"actigraph.activity": activity, "actigraph.lights": lights})


@pytest.fixture(scope="module")
def final(replayed: kg.Results) -> Array:
    rows = replayed["scorer"].data
    return np.asarray(rows[rows["final"]])


def test_the_score_is_oakleys_sum(final: Array) -> None:
    oakley = np.convolve(COUNTS, WEIGHTS, "same")
    inside = slice(4, len(oakley) - 4)
    np.testing.assert_allclose(final["score"][inside], oakley[inside], atol=1e-9)
    assert ((final["state"] == "wake") == (oakley > 40.0))[inside].all()


def test_a_provisional_score_is_given_at_once_and_the_final_one_two_minutes_later(replayed: kg.Results) -> None:
    scored = replayed["scorer"]
    late = (scored.time - scored.data["end"]) / NS
    assert np.median(late[~scored.data["final"]]) <= EPOCH_S
    assert 60.0 <= np.median(late[scored.data["final"]]) <= 150.0


def test_the_nights_numbers_are_counted_from_the_scores(replayed: kg.Results, final: Array) -> None:
    (night,) = replayed["night"].data
    asleep = final["state"][OUTSIDE : OUTSIDE + NIGHT] == "sleep"
    first = int(asleep.argmax())
    last = NIGHT - int(asleep[::-1].argmax())
    half = EPOCH_S / 60
    assert night["tib"] == pytest.approx(NIGHT * half)
    assert night["tst"] == pytest.approx(asleep.sum() * half)
    assert night["sol"] == pytest.approx(first * half)
    assert night["se"] == pytest.approx(100 * asleep.mean())
    awake_after = (~asleep[first:]).sum() * half, (~asleep[first:last]).sum() * half
    assert min(np.abs(night["waso"] - minutes) for minutes in awake_after) < 1e-9


def test_the_scores_agree_with_the_polysomnography(replayed: kg.Results, final: Array) -> None:
    """As far as made-up counts can say; by scikit-learn's kappa."""
    found = final["state"][OUTSIDE : OUTSIDE + NIGHT] == "sleep"
    assert cohen_kappa_score(ASLEEP, found) > 0.6
    assert replayed["night"].data["tst"][0] == pytest.approx(ASLEEP.sum() * EPOCH_S / 60, rel=0.1)
