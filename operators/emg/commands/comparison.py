"""Recorded sessions compared: how far cycles scatter, how far mixtures are apart, who resembles whom, and where mean curves differ."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinegraph.operators.emg.commands.comparison_groups import Group, speed_notes
from kinegraph.operators.emg.commands.session_cycles import SessionCycles
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.operators.emg.mixtures.reference import References
from kinegraph.stream.chunk import Samples

HIGHEST = 5
RESAMPLINGS = 2000
RELEVANT_PCT = 5.0
"""Differences of mean curves below this part of the larger peak are not shown, unless the user asks for it."""
EVERYONE = Group("", (0, 1))


@dataclass(frozen=True, slots=True)
class Scatter:
    """A session's cycles about a mean curve, in shares of the muscle's highest value (thesis tables 6.1 to 6.4).

    deviation, mad    mean distance of a cycle to the curve, and the mean absolute deviation of the distances: what the tables hold
    eq_6_9, eq_6_10   as printed: the root of the sum of squared distances, and the mean distance
    """

    session: str
    muscle: str
    cycles: int
    deviation: float
    mad: float
    eq_6_9: float
    eq_6_10: float


@dataclass(frozen=True, slots=True)
class Band:
    """Where two sessions' mean curves of a muscle differ: the difference (100,), its simultaneous 95 % band, the smallest difference that
    is relevant, and the places in % where the difference exceeds both. `group`: the sessions, of which the first two are compared."""

    muscle: str
    difference: Samples
    width: Samples
    relevant: float
    places: list[int]
    group: Group = EVERYONE

    @property
    def name(self) -> str:
        """The muscle, and the leg and stage."""
        return f"{self.muscle} {self.group.name}".strip()

    @property
    def pair(self) -> tuple[int, int]:
        return self.group.members[0], self.group.members[1]


@dataclass(frozen=True, slots=True)
class Comparison:
    """labels of the sessions, and the muscles that all have; intra, inter: scatter about the own and about the group's mean curve;
    distances {muscle: (n, n)}: Cauchy-Schwarz divergences; features (n, 11 m): of the 5 highest modes and their number;
    linkage (n - 1, 4): scipy's, single; means, sds {muscle: (n, 100)}: of each session's cycles, sds with n - 1;
    bands: of the first two sessions of each group; speeds: which sessions walked faster or slower than those they are compared with, or
    at several speeds;  relevant_pct: what a difference must exceed, in % of the larger peak"""

    labels: list[str]
    cycles: list[int]
    muscles: list[str]
    alike: dict[str, object]
    intra: list[Scatter]
    inter: list[Scatter]
    distances: dict[str, Samples]
    modes: dict[str, list[int]]
    features: Samples
    linkage: Samples
    means: dict[str, Samples]
    sds: dict[str, Samples]
    bands: list[Band]
    speeds: list[str]
    relevant_pct: float = RELEVANT_PCT


def compare_sessions(
    sessions: list[SessionCycles],
    mixer: PeakMixtures,
    groups: list[Group] | None = None,
    relevant_pct: float = RELEVANT_PCT,
) -> Comparison:
    """At least two sessions that were made alike, by the muscles that all of them have; without `groups`, all with each other."""
    from scipy.cluster.hierarchy import linkage

    groups = groups or [Group("", tuple(range(len(sessions))))]

    muscles = [name for name in sessions[0].muscles if all(name in s.muscles for s in sessions)]
    made = [s.references(mixer, 0, 2)[0] for s in sessions]
    where = [[s.muscles.index(name) for name in muscles] for s in sessions]
    tables = {name: _distances(made, [at[k] for at in where], mixer) for k, name in enumerate(muscles)}
    features = np.array([_features(found, at) for found, at in zip(made, where, strict=True)])
    curves = [s.curves[:, :, at] for s, at in zip(sessions, where, strict=True)]
    intra, inter = _scatters([s.label for s in sessions], muscles, curves)
    bands = [
        replace(
            _band(name, curves[group.members[0]][:, :, k], curves[group.members[1]][:, :, k], relevant_pct), group=group
        )
        for group in groups
        for k, name in enumerate(muscles)
    ]
    known = {name: [_known(c[:, :, k]) for c in curves] for k, name in enumerate(muscles)}
    return Comparison(
        [s.label for s in sessions], [len(s.curves) for s in sessions], muscles, dict(sessions[0].alike), intra, inter, tables,
        {name: [int(max(f.modes[at[k]], 0)) for f, at in zip(made, where, strict=True)] for k, name in enumerate(muscles)},
        features, linkage(standardised(features), "single"),
        {name: np.array([c.mean(axis=0) if len(c) else np.full(100, np.nan) for c in cs]) for name, cs in known.items()},
        {name: np.array([c.std(axis=0, ddof=1) if len(c) > 1 else np.full(100, np.nan) for c in cs]) for name, cs in known.items()},
        bands, speed_notes(sessions, groups), relevant_pct,
    )  # fmt: skip


def standardised(features: Samples) -> Samples:
    """Features in units of their standard deviation; what is not known, or the same everywhere, is 0."""
    known = np.isfinite(features)
    count = np.maximum(known.sum(axis=0), 1)
    off = np.where(known, features - np.where(known, features, 0.0).sum(axis=0) / count, 0.0)
    spread = np.sqrt((off**2).sum(axis=0) / count)
    return np.asarray(off / np.where(spread > 0, spread, 1.0))


def scatter(curves: Samples, mean: Samples) -> tuple[float, float, float, float]:
    """Of cycles (k, 100) about a mean curve (100,): deviation, mad, and eq. 6.9 and 6.10 as printed."""
    away = np.sqrt(((curves - mean) ** 2).sum(axis=1))
    if not len(away):
        return (np.nan,) * 4
    return (
        float(away.mean()),
        float(np.abs(away - away.mean()).mean()),
        float(np.sqrt((away**2).sum())),
        float(away.mean()),
    )


def _scatters(labels: list[str], muscles: list[str], curves: list[Samples]) -> tuple[list[Scatter], list[Scatter]]:
    intra, inter = list[Scatter](), list[Scatter]()
    for m, name in enumerate(muscles):
        scaled = [_known(c[:, :, m]) for c in curves]
        scaled = [c / c.max() if len(c) and c.max() > 0 else c for c in scaled]
        means = [c.mean(axis=0) for c in scaled if len(c)]
        everyone = np.mean(means, axis=0) if means else np.full(100, np.nan)
        for label, cycles in zip(labels, scaled, strict=True):
            own = cycles.mean(axis=0) if len(cycles) else everyone
            intra.append(Scatter(label, name, len(cycles), *scatter(cycles, own)))
            inter.append(Scatter(label, name, len(cycles), *scatter(cycles, everyone)))
    return intra, inter


def _known(curves: Samples) -> Samples:
    return np.asarray(curves[~np.isnan(curves).any(axis=1)])


def _distances(made: list[References], at: list[int], mixer: PeakMixtures) -> Samples:
    """The divergences (n, n) of a muscle's mixtures; NaN where one is missing."""
    turns = mixer.fitting().turns
    return np.array(
        [
            [a.distance(i, b.mixture(j), turns) for b, j in zip(made, at, strict=True)]
            for a, i in zip(made, at, strict=True)
        ]
    )


def _features(made: References, at: list[int]) -> Samples:
    """The eleven features of thesis 6.3.3 for each muscle: place and height of the 5 highest modes, and how many there are."""
    rows = []
    for k in at:
        count = max(int(made.modes[k]), 0)
        means = np.full((HIGHEST, 2), np.nan)
        means[: min(count, HIGHEST)] = made.means[k, : min(count, HIGHEST)]
        rows.append(np.concatenate([means[:, 0], means[:, 1], [count]]))
    return np.concatenate(rows)


def _band(muscle: str, before: Samples, after: Samples, relevant_pct: float) -> Band:
    """Difference of mean curves (after less before), with a band that holds all 100 points at once in 95 % of resamplings (bootstrap)."""
    before, after = _known(before), _known(after)
    if min(len(before), len(after)) < 2:
        return Band(muscle, np.full(100, np.nan), np.full(100, np.nan), np.nan, [])
    rng = np.random.default_rng(1)
    difference = after.mean(axis=0) - before.mean(axis=0)
    drawn = np.empty((RESAMPLINGS, 100))
    for k in range(RESAMPLINGS):
        a, b = (c[rng.integers(0, len(c), len(c))].mean(axis=0) for c in (before, after))
        drawn[k] = b - a
    spread = np.maximum(drawn.std(axis=0), 1e-12)
    most = np.quantile(np.abs((drawn - difference) / spread).max(axis=1), 0.95)
    width = most * spread
    relevant = relevant_pct / 100 * float(max(np.abs(before.mean(axis=0)).max(), np.abs(after.mean(axis=0)).max()))
    differs = np.abs(difference) > np.maximum(width, relevant)
    return Band(muscle, difference, width, relevant, np.flatnonzero(differs).tolist())
