"""Performance person by person: the epochs and nights of each taken together, and the spread over persons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.sleep.evaluation.agreement import Confusion
from kinegraph.operators.sleep.evaluation.comparison import Pair, total
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.night import Night

MEASURES = {"tst": ("TST", "min"), "se": ("SE", "%"), "sol": ("SOL", "min"), "waso": ("WASO", "min")}
METRICS = (
    "sensitivity", "specificity", "accuracy", "ppv", "npv", "kappa", "pabak", "prevalence_index", "bias_index",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class PersonAgreement:
    """What `METRICS` name is of all epochs of the person's nights together, sleep being positive; NaN where a denominator is 0.

    ppv, npv          share of the epochs estimated as sleep (wake) that are sleep (wake) in the reference
    pabak             kappa adjusted for prevalence and bias: twice the accuracy less 1
    prevalence_index  |both sleep - both wake| / epochs
    bias_index        |false sleep - false wake| / epochs (Byrt 1993)
    differences       (4,) the nights' mean of estimate less reference, in the order of `MEASURES`, in their units
    references        (4,) the nights' mean of the reference; of the nights on which both sides have the number
    """

    name: str
    nights: int
    confusion: Confusion
    differences: Samples
    references: Samples

    def metric(self, name: str) -> float:
        c = self.confusion
        n = c.epochs
        if name in ("sensitivity", "specificity", "kappa"):
            return float(getattr(c, name))
        part, whole = {
            "accuracy": (c.both_sleep + c.both_wake, n),
            "ppv": (c.both_sleep, c.both_sleep + c.false_sleep),
            "npv": (c.both_wake, c.both_wake + c.false_wake),
            "pabak": (2 * (c.both_sleep + c.both_wake) - n, n),
            "prevalence_index": (abs(c.both_sleep - c.both_wake), n),
            "bias_index": (abs(c.false_sleep - c.false_wake), n),
        }[name]
        return part / whole if whole else np.nan


def by_person(pairs: Sequence[Pair]) -> list[PersonAgreement]:
    """One for each person, in the order of their first nights."""
    made = []
    for name in dict.fromkeys(one.person for one in pairs):
        mine = [one for one in pairs if one.person == name]
        found, truth = _measures([one.found for one in mine]), _measures([one.truth for one in mine])
        differences = found - truth
        truth = np.where(np.isnan(differences), np.nan, truth)
        made.append(PersonAgreement(name, len(mine), total(mine), _means(differences), _means(truth)))
    return made


def _measures(nights: Sequence[Night]) -> Samples:
    """(nights, 4)"""
    return np.array([[getattr(one, key) for key in MEASURES] for one in nights], np.float64)


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean over persons, standard deviation, and the mean's 95 % interval by Student's t; NaN where there are too few."""

    mean: float
    sd: float
    low: float
    high: float
    persons: int


def spread(values: Samples) -> Spread:
    """Of one value (n,) per person; NaN are left out."""
    known = values[~np.isnan(values)]
    n = len(known)
    mean = float(known.mean()) if n else np.nan
    if n < 2:
        return Spread(mean, np.nan, np.nan, np.nan, n)
    from scipy.stats import t

    sd = float(known.std(ddof=1))
    half = float(t.ppf(0.975, n - 1)) * sd / n**0.5
    return Spread(mean, sd, mean - half, mean + half, n)


@dataclass(frozen=True, slots=True)
class SizeTrend:
    """A straight line over the reference: at 0, slope, and the slope's 95 % interval."""

    at_zero: float
    slope: float
    low: float
    high: float


MIN_POINTS = 4
"""Fewer persons (nights, where there is one person) say nothing about a trend or a distribution."""


def trend(reference: Samples, values: Samples) -> SizeTrend | None:
    """Least squares of `values` (n,) on `reference` (n,); None below four points, or where the reference does not vary."""
    known = ~np.isnan(values) & ~np.isnan(reference)
    x, y = reference[known], values[known]
    if len(x) < MIN_POINTS or np.ptp(x) == 0:
        return None
    from scipy.stats import linregress, t

    line = linregress(x, y)
    half = float(t.ppf(0.975, len(x) - 2)) * float(line.stderr)
    slope = float(line.slope)
    return SizeTrend(float(line.intercept), slope, slope - half, slope + half)


def residuals(reference: Samples, values: Samples, line: SizeTrend) -> Samples:
    """How far each value lies from the line, without its sign."""
    return np.asarray(np.abs(values - line.at_zero - line.slope * reference))


def normality(values: Samples) -> float | None:
    """p of Shapiro and Wilk's test; None below four values, or where they do not vary."""
    known = values[~np.isnan(values)]
    if len(known) < MIN_POINTS or np.ptp(known) == 0:
        return None
    from scipy.stats import shapiro

    return float(shapiro(known).pvalue)


def _means(values: Samples) -> Samples:
    """Of every column, without NaN; NaN where there is nothing else."""
    known = ~np.isnan(values)
    count = known.sum(axis=0)
    sums = np.where(known, values, 0.0).sum(axis=0)
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan)
