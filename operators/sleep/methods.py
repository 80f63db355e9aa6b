"""Scorers of sleep and wake: their constants, and the score of one epoch from the activity around it.

Every scorer weighs the activity of an epoch and of its neighbours; no method uses anything but movement. Where a paper prints decimal
weights they are kept here as whole numbers over a common denominator, so that a sum that falls exactly on the threshold is decided exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.stream.chunk import Samples

MethodName = Literal[
    "thesis",
    "cole_kripke_mean",
    "cole_kripke_max_30s",
    "cole_kripke_max_10s",
    "cole_kripke_actilife",
    "scripps",
    "sadeh",
    "sadeh_actilife",
    "oakley",
]


@dataclass(frozen=True, slots=True)
class Method:
    """What a scorer takes, and how far it looks.

    device     the device that it was made for; "": any movement
    measure    what an epoch's number must be (`Epochs` writes it into the stream's meta); "": not asked
    epochs_s   the epoch lengths it is defined for
    past, future  how many epochs before and after it looks at (Oakley's depend on the epoch length)
    before     what replaces epochs before the first: "zero" counts; only what was "seen"; or the epoch is "unknown"
    """

    device: str
    measure: str
    epochs_s: tuple[float, ...]
    past: int
    future: int
    before: str
    source: str


METHODS: dict[str, Method] = {
    "thesis": Method("", "", (30.0,), 10, 3, "seen", "Patterns in Motion, eq. 4.3"),
    "cole_kripke_mean": Method("ami", "", (60.0,), 4, 2, "seen", "Cole 1992, mean activity per minute"),
    "cole_kripke_max_30s": Method("ami", "maximum of 30 s", (60.0,), 4, 2, "seen", "Cole 1992, highest 30 s"),
    "cole_kripke_max_10s": Method("ami", "maximum of 10 s", (60.0,), 4, 2, "seen", "Cole 1992, highest 10 s"),
    "cole_kripke_actilife": Method("actigraph", "", (60.0,), 4, 2, "zero", "Cole 1992, as ActiLife 6 has it"),
    "scripps": Method("actiwatch", "", (30.0,), 10, 2, "seen", "Kripke 2010"),
    "sadeh": Method("ami", "", (60.0,), 5, 5, "seen", "Sadeh 1994"),
    "sadeh_actilife": Method("actigraph", "", (60.0,), 5, 5, "zero", "Sadeh 1994, as ActiLife 6 has it"),
    "oakley": Method("actiwatch", "", (15.0, 30.0, 60.0, 120.0), 0, 0, "unknown", "Oakley 1997, as Actiware has it"),
}

COLE_KRIPKE = {
    "cole_kripke_mean": ((106, 54, 58, 76, 230, 74, 67), 1e3, np.inf),
    "cole_kripke_max_30s": ((50, 30, 14, 28, 121, 8, 50), 1e4, np.inf),
    "cole_kripke_max_10s": ((550, 378, 413, 699, 1736, 287, 309), 1e5, np.inf),
    "cole_kripke_actilife": ((106, 54, 58, 76, 230, 74, 67), 1e5, 30_000.0),
}
"""Weights from the oldest epoch on, what a sum of 1 is in them, and where counts are clipped (ActiLife: counts / 100, at most 300)."""

SCRIPPS = tuple(204 * w for w in (64, 74, 112, 112, 118, 118, 128, 188, 280, 664, 300, 112, 100))
"""0.204 times the printed weights, times 10 million."""

OAKLEY = {
    15.0: ((1,) * 4 + (5,) * 4 + (100,) + (5,) * 4 + (1,) * 4, 25),
    30.0: ((1, 1, 5, 5, 50, 5, 5, 1, 1), 25),
    60.0: ((1, 5, 25, 5, 1), 25),
    120.0: ((6, 25, 6), 50),
}
"""By epoch length: the weights in whole numbers, and what a weight of 1 is in them."""

THESIS_ALPHA = 0.3
"""Ours: the thesis gives no value. One epoch in movement amid stillness stays asleep, two in a row are awake (sigma 2)."""


@dataclass(slots=True)
class ScoringRule:
    """A scorer made ready for one epoch length.

    weights  (past + 1 + future,)  from the oldest epoch on; for Sadeh ones
    unit     what a score of 1 is in weighted sums
    limit    the score at which wake begins (Sadeh: below which it does)
    """

    sadeh: bool
    whole: bool
    weights: Samples
    past: int
    unit: float
    limit: float
    wake_at_limit: bool
    clip: float
    active_above: float
    before: str

    @property
    def future(self) -> int:
        return len(self.weights) - self.past - 1

    def score(self, around: Samples, min_seen: float) -> tuple[float, bool]:
        """Score of the middle epoch, and whether it is sleep; NaN where it, or too much around it, was not seen.

        around  (past + 1 + future,)  activity from the oldest epoch on; NaN: not seen, and left out of the weighing
        """
        seen = ~np.isnan(around)
        total = float(self.weights.sum())
        known = float(self.weights[seen].sum())
        if not seen[self.past] or known < min_seen * total:
            return np.nan, False
        if self.sadeh:
            return self._sadeh(around, seen)
        x = self._counted(around[seen])
        raw = 0.0
        for weight, value in zip(self.weights[seen].tolist(), x.tolist(), strict=True):
            raw += weight * value
        here, limit = raw * total, self.limit * self.unit * known
        awake = here >= limit if self.wake_at_limit else here > limit
        return here / (self.unit * known), not awake

    def strongest(self, around: Samples, min_seen: float) -> tuple[int, float, float]:
        """The epoch whose movement moves the score most towards wake: its place in `around`, its weight, what it adds to the score.

        The weight is its share of all weight that was seen; of two that add the same the nearer one counts. Sadeh weighs no single epoch:
        the weight is NaN, and what is added is the score less what it would be without that movement. Place -1, and NaN: there is no
        movement, or no score.
        """
        score, _ = self.score(around, min_seen)
        seen = ~np.isnan(around)
        if score != score or not (around[seen] > 0).any():
            return -1, np.nan, np.nan
        known = float(self.weights[seen].sum())
        if self.sadeh:
            adds = np.array(
                [score - self.score(np.where(one, 0.0, around), min_seen)[0] for one in np.eye(len(around), dtype=bool)]
            )
        else:
            adds = np.zeros(len(around))
            adds[seen] = (
                self.weights[seen] * self._counted(around[seen]) * float(self.weights.sum()) / (self.unit * known)
            )
        adds[~(around > 0)] = 0.0
        size = -adds if self.sadeh else adds
        found = int(min(np.flatnonzero(size == size.max()), key=lambda place: abs(int(place) - self.past)))
        if not size[found] > 0:
            return -1, np.nan, np.nan
        return found, np.nan if self.sadeh else float(self.weights[found]) / known, float(adds[found])

    def _counted(self, x: Samples) -> Samples:
        """Activity as the method counts it."""
        x = np.minimum(x, self.clip)
        if self.active_above == self.active_above:
            x = (x > self.active_above).astype(np.float64)
        return np.rint(x) if self.whole else x

    def _sadeh(self, around: Samples, seen: Samples) -> tuple[float, bool]:
        x = np.minimum(around, self.clip)
        there = x[seen]
        recent = x[: self.past + 1][seen[: self.past + 1]]
        middling = float(((there >= 50) & (there < 100)).sum()) * len(x) / len(there)
        spread = float(recent.std(ddof=1)) if len(recent) > 1 else 0.0
        now = max(float(x[self.past]), 0.0)
        score = 7.601 - 0.065 * float(there.mean()) - 1.08 * middling - 0.056 * spread - 0.703 * float(np.log(now + 1))
        return score, score > self.limit if self.wake_at_limit else score >= self.limit


def rule(
    method: str, epoch_s: float, *, threshold: float | None, active_above: float, sigma_epochs: float, whole: bool
) -> ScoringRule:
    """The rule of a scorer at an epoch length it is defined for. `threshold`: in place of its own; `whole`: counts are rounded."""
    known = METHODS[method]
    weights, unit, limit, clip, at = _constants(method, epoch_s, sigma_epochs)
    return ScoringRule(
        sadeh=method.startswith("sadeh"),
        whole=whole,
        weights=weights,
        past=known.past if method != "oakley" else len(weights) // 2,
        unit=unit,
        limit=limit if threshold is None else threshold,
        wake_at_limit=at,
        clip=clip,
        active_above=active_above if method == "thesis" else np.nan,
        before=known.before,
    )


def _constants(method: str, epoch_s: float, sigma_epochs: float) -> tuple[Samples, float, float, float, bool]:
    """Weights, unit, limit, clip, and whether a score on the limit is wake."""
    if method in COLE_KRIPKE:
        weights, unit, clip = COLE_KRIPKE[method]
        return np.array(weights, np.float64), unit, 1.0, clip, True
    if method == "scripps":
        return np.array(SCRIPPS, np.float64), 1e7, 1.0, np.inf, True
    if method == "oakley":
        whole, unit = OAKLEY[epoch_s]
        return np.array(whole, np.float64), unit, 40.0, np.inf, False
    if method == "sadeh":
        return np.ones(11), 1.0, 0.0, np.inf, False
    if method == "sadeh_actilife":
        return np.ones(11), 1.0, -4.0, 300.0, True
    bell = np.exp(-0.5 * (np.arange(-10, 4) / sigma_epochs) ** 2)
    return bell / bell.sum(), 1.0, THESIS_ALPHA, np.inf, True
