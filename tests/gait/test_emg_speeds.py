"""Cycles of very different speed: left out with the reason, in no mixture, and reported when sessions are compared."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.emg.commands.compare import compare
from kinegraph.operators.emg.commands.train_model import emg_model
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.stream.chunk import StreamSpec
from tests.gait.test_emg_compare import run, session
from tests.gait.test_emg_mixtures_live import bursts
from tests.support.emg_run import contacts, drive, stamps

USUAL, SLOW = 30.0, 70.0
"""Where a cycle's burst is, in %: of the usual ones, and of those that take more than twice as long."""


def walked(seconds):
    """Cycles of these lengths, one muscle: the closed ones and the mixtures of their peaks."""
    touch = 1.0 + np.concatenate([[0.0], np.cumsum(seconds)])
    time = stamps(int((touch[-1] + 1.0) * 100.0), 100.0)
    data = np.full(len(time), 0.1)
    for (a, b), took in zip(pairwise(touch), seconds, strict=True):
        place = (time / 1e9 - a) / (b - a) * 100.0
        data += np.exp(-0.5 * ((place - (SLOW if took > 2.0 else USUAL)) / 4.0) ** 2)
    spec = StreamSpec((1,), rate_hz=100.0, channels=("TA",), units=("uV",))
    made = drive(Cycles(), {"signal": (spec, time, data[:, None]), "touchdown": contacts(touch)}, 50)
    cycles = {port: made[port] for port in ("maxima", "closed", "cycles")}
    return made["closed"][2], drive(PeakMixtures(), cycles)["mixture"][2]


def test_cycles_of_another_speed_are_in_no_mixture_and_the_reason_is_told():
    seconds = np.full(24, 1.0)
    seconds[[9, 14, 15, 20]] = 2.3
    closed, mixtures = walked(seconds)
    assert closed["number"][closed["rejected"] == "irregular"].tolist() == [10, 15, 16, 21]
    assert not np.isin(mixtures["number"], [10, 15, 16, 21]).any()
    last = mixtures[-1]
    assert last["cycles"] == 20 and last["modes"] == 1 and abs(last["mean"][0, 0] - USUAL) < 1.5


def test_a_new_speed_counts_once_most_of_the_latest_cycles_have_it():
    closed, mixtures = walked(np.repeat([1.0, 2.3], 20))
    left_out = closed["number"][closed["rejected"] == "irregular"]
    assert left_out.tolist() == list(range(21, 27)), "until six of the latest eleven have it"
    assert not np.isin(mixtures["number"], left_out).any()
    last = mixtures[-1]
    modes = sorted(zip(last["weight"][:2], last["mean"][:2, 0], strict=True))
    assert last["modes"] == 2
    assert modes == [
        (pytest.approx(0.3), pytest.approx(USUAL, abs=1.5)),
        (pytest.approx(0.7), pytest.approx(SLOW, abs=1.5)),
    ]


def test_sessions_of_another_speed_are_compared_with_a_word(tmp_path):
    usual, slow = bursts(10, seed=1), bursts(10, seed=2)
    slow["closed"][2]["duration_s"] = 2.3
    files = [session(tmp_path / f"{name}.mcap", made) for name, made in (("usual", usual), ("slow", slow))]
    done = run(compare, *files, "-o", tmp_path / "out")
    sentence = "slow: cycles of 2.30 s, 2.30 times those of usual; what differs may be the speed"
    assert done.exit_code == 0 and sentence in done.output.replace("\n", " ")
    assert sentence in (tmp_path / "out" / "comparison.html").read_text()
    trained = run(emg_model, *files, "-o", tmp_path / "m.npz")
    assert trained.exit_code == 0 and sentence in trained.output.replace("\n", " ")
    assert "may be the speed" not in run(emg_model, files[0], "-o", tmp_path / "one.npz").output
