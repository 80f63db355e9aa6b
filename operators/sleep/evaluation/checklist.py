"""What a validation should report, step by step, after Menghini et al. 2021, and what these nights answer of it.

The steps and their names are those of L. Menghini, N. Cellini, A. Goldstone, F. C. Baker and M. de Zambotti: A standardized framework for
testing the performance of sleep-tracking technology, Sleep 44(2), zsaa170; the wording, the items about the study, and every departure
that an item names are ours. What no file says is 'not given'.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.sleep.evaluation.agreement import Limits, limits
from kinegraph.operators.sleep.evaluation.comparison import Pair, total
from kinegraph.operators.sleep.evaluation.persons import (
    MEASURES,
    METRICS,
    MIN_POINTS,
    PersonAgreement,
    SizeTrend,
    Spread,
    by_person,
    normality,
    residuals,
    spread,
    trend,
)
from kinegraph.stream.chunk import NS, Samples

NOT_GIVEN = "not given"
STUDY = {
    "device": "device, with versions of hardware, firmware and scoring",
    "reference": "reference method, who scored it, by which rules",
    "sample": "who slept: number, age, sex, health, medication",
    "criteria": "who was to be taken in, and who left out",
    "setting": "where, and under which conditions",
    "lights": "how lights off and lights on were found, on both sides",
    "clocks": "how the two clocks were brought together",
}
"""What only the people who made the study know: key, and what is asked."""


@dataclass(frozen=True, slots=True)
class ChecklistItem:
    """One thing to report: which step asks it, what was done, and what answers it ('not given')."""

    step: str
    item: str
    done: str
    answer: str


@dataclass(frozen=True, slots=True)
class Evaluated:
    """Nights and what is known of them beyond their epochs.

    study     answers to `STUDY`, by key
    offsets   seconds that were added to the references' times, a night each
    left_out  nights that were left out, and why
    """

    pairs: Sequence[Pair]
    study: Mapping[str, str]
    offsets: Sequence[float] = ()
    left_out: Sequence[tuple[str, str]] = ()


def checklist(of: Evaluated) -> list[ChecklistItem]:
    """Every item, in order."""
    persons = by_person(of.pairs)
    asked = [
        ChecklistItem("study", what, "from the study's own table", of.study.get(key, "").strip() or NOT_GIVEN)
        for key, what in STUDY.items()
    ]
    return [*asked, *_data(of, persons), *_discrepancies(of.pairs), *_epochs(of.pairs, persons)]


def limits_of(pairs: Sequence[Pair]) -> dict[str, Limits]:
    """Bias and limits of agreement of every measure of `MEASURES`, nights nested in persons."""
    who = [one.person for one in pairs]
    return {key: limits(_differences(pairs, key)[1], who) for key in MEASURES}


def spreads(persons: Sequence[PersonAgreement]) -> dict[str, Spread]:
    """Every metric of `METRICS`, over persons."""
    return {name: spread(np.array([one.metric(name) for one in persons])) for name in METRICS}


def _data(of: Evaluated, persons: Sequence[PersonAgreement]) -> list[ChecklistItem]:
    step, pairs, c = "1 data", of.pairs, total(list(of.pairs))
    lengths = sorted({_epoch_s(one) for one in pairs} - {0.0})
    per_person = [one.nights for one in persons]
    own = " A night without a named person counts as a person of its own."
    left = "; ".join(f"{name}: {why}" for name, why in of.left_out)
    late = f"{min(of.offsets):g} to {max(of.offsets):g} s added to the reference's times" if of.offsets else NOT_GIVEN
    every = c.epochs + c.unknown
    return [
        ChecklistItem(step, "nights and persons", f"counted.{own}",
                      f"{len(pairs)} nights of {len(persons)} persons, {min(per_person)} to {max(per_person)} each"),
        ChecklistItem(step, "nights left out, and why", "column exclude of the table of nights", left or "no night left out there"),
        ChecklistItem(step, "one epoch length on both sides", "each epoch of the reference is held against the estimate at its middle",
                      f"{' and '.join(f'{s:g}' for s in lengths)} s" if lengths else NOT_GIVEN),
        ChecklistItem(step, "shift between the clocks", "as given with --offset or in the table of nights; not estimated", late),
        ChecklistItem(step, "the same time in bed on both sides", "the reference's first to last epoch is taken for both",
                      f"{_mean_sd([one.truth.tib for one in pairs])} min"),
        ChecklistItem(step, "epochs without a score", "left out of both sides, and counted",
                      f"{c.unknown} of {every} ({100 * c.unknown / every:.1f} %)"),
        ChecklistItem(step, "stages of sleep", "light, deep and REM sleep are not estimated; the reference's are all sleep", NOT_GIVEN),
    ]  # fmt: skip


def _discrepancies(pairs: Sequence[Pair]) -> list[ChecklistItem]:
    step, found = "2 discrepancies", limits_of(pairs)
    both, bias, around, trends, wider, normal = [], [], [], [], [], []
    for key, (name, unit) in MEASURES.items():
        e, r = ([getattr(side, key) for side in sides] for sides in _sides(pairs))
        both.append(f"{name} {_mean_sd(e)} against {_mean_sd(r)} {unit}")
        one = found[key]
        bias.append(f"{name} {_n(one.bias)} {unit}{_interval(one.bias_interval)}")
        if one.low == one.low:
            around.append(
                f"{name} {_n(one.low)}{_interval(one.low_interval)} to {_n(one.high)}{_interval(one.high_interval)} {unit}"
            )
        x, y = _points(pairs, key)
        if line := trend(x, y):
            trends.append(f"{name}: {_told(line)}")
            if spreading := trend(x, residuals(x, y, line)):
                wider.append(f"{name}: {_told(spreading)}")
        if (p := normality(y)) is not None:
            normal.append(f"{name}: p = {p:.3f}{', not normal' if p < 0.05 else ''}")
    few = f"one point per person (per night where one person slept); from {MIN_POINTS} points on"
    return [
        ChecklistItem(step, "measures of both sides, mean (SD) of nights", "AASM's definitions; estimate against reference",
                      "; ".join(both)),
        ChecklistItem(step, "every person's own differences", "table of persons, and nights.csv with --out", "see the table of persons"),
        ChecklistItem(step, "bias, with 95 % intervals", "nights nested in persons (Bland and Altman 2007)", _list(bias)),
        ChecklistItem(step, "limits of agreement, with 95 % intervals", "the same; intervals by MOVER (Zou 2013), not by a bootstrap",
                      _list(around)),
        ChecklistItem(step, "does the bias depend on the size", f"line of the differences over the reference, {few}", _list(trends)),
        ChecklistItem(step, "does the spread depend on the size", f"line of that line's absolute residuals over the reference, {few}",
                      _list(wider)),
        ChecklistItem(step, "are the differences normal", f"Shapiro and Wilk's test, {few}", _list(normal)),
        ChecklistItem(step, "limits that follow the size, or of logarithms", "not done: where one of the last "
                      "three items fails, the limits above do not hold at every size", NOT_GIVEN),
        ChecklistItem(step, "Bland-Altman plots", "differences over the mean of both sides (the framework: over the reference)",
                      "see the picture: TST, SOL, WASO; SE not drawn"),
    ]  # fmt: skip


def _epochs(pairs: Sequence[Pair], persons: Sequence[PersonAgreement]) -> list[ChecklistItem]:
    step, c, over = "3 epoch by epoch", total(list(pairs)), spreads(persons)
    counts = f"sleep as sleep {c.both_sleep}, sleep as wake {c.false_wake}, wake as wake {c.both_wake}, wake as sleep {c.false_sleep}"

    def spread(*names: str) -> str:
        return "; ".join(f"{name} {_spread(over[name])}" for name in names)

    done = "mean over persons (SD), 95 % interval of the mean by Student's t (it may pass 1)"
    return [
        ChecklistItem(step, "error matrix, epochs", "all nights together; the reference's state first", counts),
        ChecklistItem(step, "error matrix, shares", f"{done}; the other shares are 1 less these", spread("sensitivity", "specificity")),
        ChecklistItem(step, "every person's own metrics", "from all epochs of the person's nights", "see the table of persons"),
        ChecklistItem(step, "accuracy and predictive values", done, spread("accuracy", "ppv", "npv")),
        ChecklistItem(step, "kappa, and kappa for prevalence and bias", done,
                      spread("kappa", "pabak", "prevalence_index", "bias_index")),
        ChecklistItem(step, "ROC curve", "not done: the scores are two states, without a grade", NOT_GIVEN),
    ]  # fmt: skip


def _epoch_s(one: Pair) -> float:
    return float(one.time[1] - one.time[0]) / NS if len(one.time) > 1 else 0.0


def _sides(pairs: Sequence[Pair]) -> tuple[list[object], list[object]]:
    return [one.found for one in pairs], [one.truth for one in pairs]


def _differences(pairs: Sequence[Pair], key: str) -> tuple[Samples, Samples]:
    """The reference's numbers, and estimate less reference, a night each."""
    e, r = (np.array([getattr(side, key) for side in sides], np.float64) for sides in _sides(pairs))
    return r, e - r


def _points(pairs: Sequence[Pair], key: str) -> tuple[Samples, Samples]:
    """Reference and difference, independent of one another: of persons, or of the nights of the only one; without NaN."""
    persons, column = by_person(pairs), list(MEASURES).index(key)
    if len(persons) > 1:
        x = np.array([one.references[column] for one in persons])
        y = np.array([one.differences[column] for one in persons])
    else:
        x, y = _differences(pairs, key)
    known = ~np.isnan(x) & ~np.isnan(y)
    return x[known], y[known]


def _told(line: SizeTrend) -> str:
    sure = "it does" if line.low > 0 or line.high < 0 else "not shown"
    slope = f"{'-' if line.slope < 0 else '+'} {abs(line.slope):.3f}"
    return f"{line.at_zero:.2f} {slope} x reference, slope {line.low:.3f} to {line.high:.3f}: {sure}"


def _list(parts: Sequence[str]) -> str:
    return "; ".join(parts) or NOT_GIVEN


def _mean_sd(values: Sequence[float]) -> str:
    known = np.array(values, np.float64)
    known = known[~np.isnan(known)]
    if not len(known):
        return NOT_GIVEN
    return f"{known.mean():.1f}" + (f" ({known.std(ddof=1):.1f})" if len(known) > 1 else "")


def _spread(s: Spread) -> str:
    if s.mean != s.mean:
        return NOT_GIVEN
    return f"{s.mean:.3f}" + (f" ({s.sd:.3f}), {s.low:.3f} to {s.high:.3f}" if s.sd == s.sd else "")


def _interval(around: tuple[float, float]) -> str:
    return f" ({_n(around[0])} to {_n(around[1])})" if around[0] == around[0] else ""


def _n(value: float) -> str:
    return f"{value:.1f}" if value == value else NOT_GIVEN
