"""How well two scorings of the same nights agree: epoch by epoch, and in the numbers of a night."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE, States


@dataclass(frozen=True, slots=True)
class Confusion:
    """Epochs that both sides know, sleep being positive, and how many either side did not know."""

    both_sleep: int
    both_wake: int
    false_sleep: int
    false_wake: int
    unknown: int

    @classmethod
    def of(cls, estimate: States, reference: States) -> Confusion:
        known = (estimate != UNKNOWN) & (reference != UNKNOWN)
        e, r = estimate[known], reference[known]
        return cls(
            int(((e == SLEEP) & (r == SLEEP)).sum()),
            int(((e == WAKE) & (r == WAKE)).sum()),
            int(((e == SLEEP) & (r == WAKE)).sum()),
            int(((e == WAKE) & (r == SLEEP)).sum()),
            int((~known).sum()),
        )

    def __add__(self, other: Confusion) -> Confusion:
        return Confusion(
            self.both_sleep + other.both_sleep,
            self.both_wake + other.both_wake,
            self.false_sleep + other.false_sleep,
            self.false_wake + other.false_wake,
            self.unknown + other.unknown,
        )

    @property
    def epochs(self) -> int:
        return self.both_sleep + self.both_wake + self.false_sleep + self.false_wake

    @property
    def sensitivity(self) -> float:
        """Share of the reference's sleep that was found; NaN for a reference without sleep."""
        return _ratio(self.both_sleep, self.both_sleep + self.false_wake)

    @property
    def specificity(self) -> float:
        """Share of the reference's wake that was found."""
        return _ratio(self.both_wake, self.both_wake + self.false_sleep)

    @property
    def kappa(self) -> float:
        """Cohen's kappa; NaN where one side has a single state throughout and so has the other."""
        n = self.epochs
        if not n:
            return np.nan
        agreed = (self.both_sleep + self.both_wake) / n
        e, r = (self.both_sleep + self.false_sleep) / n, (self.both_sleep + self.false_wake) / n
        chance = e * r + (1 - e) * (1 - r)
        return _ratio(agreed - chance, 1 - chance)


@dataclass(frozen=True, slots=True)
class Limits:
    """Bland and Altman's bias and 95 % limits of agreement, each with its 95 % interval (low, high); NaN where too few nights."""

    bias: float
    bias_interval: tuple[float, float]
    low: float
    low_interval: tuple[float, float]
    high: float
    high_interval: tuple[float, float]
    nights: int
    persons: int


def limits(differences: Samples, persons: Sequence[str]) -> Limits:
    """Limits of agreement of differences (nights,), estimate less reference, of nights nested in persons.

    The bias is the mean of the persons' means; the variance is that between persons' means plus what their number of nights leaves of
    that within persons (Bland and Altman 2007); intervals by MOVER (Zou 2013). With one night each these are Bland and Altman's of 1986
    but for the interval's form. Nights of a single person are taken as independent: the limits are that person's. Differences that are
    NaN (a night without sleep has no SOL) are left out.
    """
    known = ~np.isnan(differences)
    d = differences[known]
    who = np.array(persons)[known]
    names = np.unique(who)
    if len(names) == 1:
        who, names = np.arange(len(d)).astype(str), np.arange(len(d)).astype(str)
    count = len(np.unique(np.array(persons)[known]))
    groups = [d[who == name] for name in names]
    n, total = len(groups), len(d)
    nan = (np.nan, np.nan)
    if n < 2:
        return Limits(float(d.mean()) if total else np.nan, nan, np.nan, nan, np.nan, nan, total, count)
    from scipy.stats import chi2, norm, t

    means = np.array([g.mean() for g in groups])
    bias, between = float(means.mean()), float(means.var(ddof=1))
    share = 1 - float(np.mean([1 / len(g) for g in groups]))
    spare = total - n
    within = sum(float(((g - g.mean()) ** 2).sum()) for g in groups) / spare if spare else 0.0
    spread = between + share * within
    parts = [(between, n - 1), *([(share * within, spare)] if spare else [])]
    down = spread - np.sqrt(sum((v * (1 - k / chi2.ppf(0.975, k))) ** 2 for v, k in parts))
    up = spread + np.sqrt(sum((v * (k / chi2.ppf(0.025, k) - 1)) ** 2 for v, k in parts))
    half = float(t.ppf(0.975, n - 1)) * np.sqrt(between / n)
    z = float(norm.ppf(0.975))
    far, near, wide = z * np.sqrt(spread), z * np.sqrt(max(down, 0.0)), z * np.sqrt(up)
    inner, outer = np.hypot(half, far - near), np.hypot(half, wide - far)
    return Limits(
        bias,
        (bias - half, bias + half),
        bias - far,
        (bias - far - outer, bias - far + inner),
        bias + far,
        (bias + far - inner, bias + far + outer),
        total,
        count,
    )


DRAWS, MIN_PERSONS = 2000, 3


def interval(
    confusions: Sequence[Confusion], persons: Sequence[str], of: Callable[[Confusion], float]
) -> tuple[float, float]:
    """95 % interval of a pooled number by the bootstrap over persons, all nights of a person together; NaN below three persons.

    Epochs of a night, and nights of a person, are alike: intervals that take epochs as independent are far too narrow. With few persons
    this one is too narrow, too.
    """
    names = list(dict.fromkeys(persons))
    if len(names) < MIN_PERSONS:
        return np.nan, np.nan
    totals = []
    for name in names:
        total = Confusion(0, 0, 0, 0, 0)
        for one, who in zip(confusions, persons, strict=True):
            total = total + one if who == name else total
        totals.append([total.both_sleep, total.both_wake, total.false_sleep, total.false_wake, total.unknown])
    counts = np.array(totals)
    drawn = np.random.default_rng(1).integers(len(names), size=(DRAWS, len(names)))
    values = np.array([of(Confusion(*row)) for row in counts[drawn].sum(axis=1).tolist()])
    known = values[~np.isnan(values)]
    if not len(known):
        return np.nan, np.nan
    low, high = np.percentile(known, [2.5, 97.5])
    return float(low), float(high)


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else np.nan
