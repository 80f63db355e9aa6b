"""Every scorer against its paper's formula, with the coefficients as printed, read epoch by epoch; and epochs against a plain grouping."""

from __future__ import annotations

from statistics import fmean, stdev
from typing import Any, get_args

import numpy as np
import pytest

from kinegraph.operators.sleep.epochs import Epochs
from kinegraph.operators.sleep.methods import METHODS, MethodName, rule
from kinegraph.operators.sleep.scorer import SleepScorer
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from tests.sleep.sleep_data import final, run

COLE = [106.0, 54.0, 58.0, 76.0, 230.0, 74.0, 67.0]
COLE_30S = [50.0, 30.0, 14.0, 28.0, 121.0, 8.0, 50.0]
COLE_10S = [550.0, 378.0, 413.0, 699.0, 1736.0, 287.0, 309.0]
SCRIPPS = [0.0064, 0.0074, 0.0112, 0.0112, 0.0118, 0.0118, 0.0128, 0.0188, 0.0280, 0.0664, 0.0300, 0.0112, 0.0100]
OAKLEY = {
    15.0: [0.04] * 4 + [0.20] * 4 + [4.00] + [0.20] * 4 + [0.04] * 4,
    30.0: [0.04, 0.04, 0.20, 0.20, 2.00, 0.20, 0.20, 0.04, 0.04],
    60.0: [0.04, 0.20, 1.00, 0.20, 0.04],
    120.0: [0.12, 0.50, 0.12],
}
SCORERS = [(m, e) for m in get_args(MethodName) for e in METHODS[m].epochs_s if m != "thesis"]


def weighted(method: str, epoch_s: float) -> tuple[list[float], int, float]:
    """Weights from the oldest epoch on, how many epochs come before the one that is scored, and the score at which wake begins."""
    if method == "oakley":
        return OAKLEY[epoch_s], len(OAKLEY[epoch_s]) // 2, 40.0
    if method == "scripps":
        return [0.204 * w for w in SCRIPPS], 10, 1.0
    weights, factor = {
        "cole_kripke_mean": (COLE, 0.001),
        "cole_kripke_max_30s": (COLE_30S, 0.0001),
        "cole_kripke_max_10s": (COLE_10S, 0.00001),
        "cole_kripke_actilife": (COLE, 0.001),
    }[method]
    return [factor * w for w in weights], 4, 1.0


def expected(method: str, epoch_s: float, counts: list[float], i: int) -> tuple[float, bool]:
    """The score of epoch `i`, and whether it is sleep; only where all epochs around it are there."""
    if method.startswith("sadeh"):
        x = [min(c, 300.0) for c in counts] if method == "sadeh_actilife" else counts
        around = x[i - 5 : i + 6]
        natural = sum(50 <= c < 100 for c in around)
        score = 7.601 - 0.065 * fmean(around) - 1.08 * natural - 0.056 * stdev(x[i - 5 : i + 1])
        score -= 0.703 * np.log(x[i] + 1)
        return float(score), score > -4 if method == "sadeh_actilife" else score >= 0
    weights, past, limit = weighted(method, epoch_s)
    x = [min(c / 100, 300.0) for c in counts] if method == "cole_kripke_actilife" else counts
    score = sum(w * x[i - past + k] for k, w in enumerate(weights))
    return score, score <= limit if method == "oakley" else score < limit


def test_of_a_count_below_zero_no_logarithm_is_taken() -> None:
    """No device gives one, but an adapter's offset may; NumPy warned, and the epoch had no score."""
    made = rule("sadeh", 60.0, threshold=None, active_above=np.nan, sigma_epochs=1.0, whole=False)
    around = np.array([0.0, 3.0, 60.0, 0.0, 5.0, -7.0, 0.0, 0.0, 90.0, 0.0, 1.0])
    score, asleep = made.score(around, 1.0)
    assert score == pytest.approx(7.601 - 0.065 * fmean(around) - 1.08 * 2 - 0.056 * stdev(around[:6]))
    assert asleep == (score >= 0)


@pytest.mark.parametrize(("method", "epoch_s"), SCORERS)
def test_scores_are_the_papers_formula(method: Any, epoch_s: float) -> None:
    rng = np.random.default_rng(5)
    level = {"cole_kripke_actilife": 4000.0, "cole_kripke_max_10s": 60.0}.get(method, 40.0)
    counts = np.rint(rng.gamma(0.5, 2.0, 600) * level * rng.choice([0.02, 1.0, 30.0], 600, p=[0.6, 0.35, 0.05]))
    meta = {"device": METHODS[method].device, "site": "wrist", "measure": METHODS[method].measure}
    spec = StreamSpec((1,), rate_hz=1 / epoch_s, channels=("wrist",), units=("counts",), meta=meta)
    time = np.arange(600) * round(epoch_s * NS)
    _, events = run(SleepScorer(method), spec, Chunk(time, counts[:, None], int(time[-1])))
    rows = final(events)
    assert len(rows) == 600 and (rows["onset"] == time).all()
    states = set()
    for i in range(20, 580):
        score, asleep = expected(method, epoch_s, counts.tolist(), i)
        assert rows["score"][i] == pytest.approx(score, rel=1e-9, abs=1e-9)
        assert rows["state"][i] == ("sleep" if asleep else "wake")
        states.add(asleep)
    assert states == {True, False}


def epochs_by_hand(
    time: Array, x: Array, epoch_ns: int, max_silent: int, measure: str
) -> list[tuple[int, float, bool]]:
    """(onset, value, whether what was before is lost) of every epoch, from its samples; NaN for the first silent ones."""
    made: list[tuple[int, float, bool]] = []
    whole = {"sum": np.sum, "maximum": np.max, "mean": np.mean}[measure]
    before = int(time[0]) // epoch_ns - 1
    for epoch in sorted({int(t) // epoch_ns for t in time}):
        silent = epoch - before - 1
        made += [((before + 1 + k) * epoch_ns, np.nan, False) for k in range(min(silent, max_silent))]
        made.append((epoch * epoch_ns, float(whole(x[time // epoch_ns == epoch])), silent > max_silent))
        before = epoch
    return made


@pytest.mark.parametrize("measure", ["sum", "maximum", "mean"])
@pytest.mark.parametrize("one_by_one", [True, False])
def test_epochs_are_their_samples_whatever_silence_lies_between(measure: Any, one_by_one: bool) -> None:
    rng = np.random.default_rng(8)
    steps = rng.choice([0.4, 1.0, 7.0, 12.0, 15.0, 40.0], 200, p=[0.6, 0.2, 0.05, 0.05, 0.05, 0.05])
    time, x = (np.cumsum(steps) * NS).astype(np.int64), rng.gamma(1.0, 1.0, 200)
    operator = Epochs(epoch_s=3.0, measure=measure, reset_gap_s=9.0, min_seen=1e-6)
    operator.open({"in": StreamSpec((1,), channels=("wrist",), units=("counts",))})
    cuts = range(200) if one_by_one else [0]
    chunks = [Chunk(time[k : k + 1] if one_by_one else time, x[k : k + 1, None] if one_by_one else x[:, None],
                    int(time[k if one_by_one else -1])) for k in cuts]  # fmt: skip
    emitted = [c for chunk in chunks for _, c in operator.process("in", chunk)]
    emitted += [c for _, c in operator.process("in", Chunk(time[:0], x[:0, None], FOREVER))]
    found, lost, promised = [], False, -1
    for chunk in emitted:
        lost = lost or chunk.lost != 0
        for t, value in zip(chunk.time.tolist(), chunk.data[:, 0].tolist(), strict=True):
            assert t > promised
            found.append((t, value, lost))
            lost = False
        promised = max(promised, chunk.until)
    wanted = epochs_by_hand(time, x, 3 * NS, 3, measure)
    assert [(t, after) for t, _, after in found] == [(t, after) for t, _, after in wanted]
    np.testing.assert_allclose([v for _, v, _ in found], [v for _, v, _ in wanted])
    assert sum(after for _, _, after in wanted) > 5 and sum(np.isnan(v) for _, v, _ in wanted) > 10
