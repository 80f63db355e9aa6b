"""A muscle's mixture that later ones are compared with, and how far from it halves of its own cycles lie by chance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS
from kinegraph.operators.emg.mixtures.distance import cauchy_schwarz
from kinegraph.operators.emg.mixtures.events import MOST_MODES
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.refit import Fitting, Refit
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.data.design_cache import remembered
from kinegraph.stream.kernel import kernel

SHARE = 0.99
OWN, FULL, NOISE, FIRST_HALF = range(4)
FULL_CYCLES = 20
"""All points are taken of this many cycles at most: there are a hundred in each."""


@dataclass(slots=True)
class References:
    """Of `g` mixtures, each: modes (g,), -1 while it is not known yet, 0 where it cannot be; weights, means, covariances (g, 16, ...);
    cycles (g,): how many curves it is of; limit (g,): the 99th percentile of distances between random parts; full, noise (g,): its
    distance from the mixture of all points of the first 20 curves, and from that of noise of their height. NaN: not known."""

    modes: Times
    weights: Samples
    means: Samples
    covariances: Samples
    cycles: Times
    limit: Samples
    full: Samples
    noise: Samples

    @staticmethod
    def empty(count: int) -> References:
        k = MOST_MODES
        return References(
            np.full(count, -1), np.zeros((count, k)), np.zeros((count, k, 2)), np.zeros((count, k, 3)),
            np.zeros(count, np.int64), *(np.full(count, np.nan) for _ in range(3)),
        )  # fmt: skip

    def distance(self, which: int, mixture: tuple[Samples, Samples, Samples], turns: int) -> float:
        """The Cauchy-Schwarz divergence of a mixture from one of these; NaN where either is not known."""
        if self.modes[which] <= 0 or not len(mixture[0]):
            return np.nan
        return float(cauchy_schwarz(*self.mixture(which), *mixture, turns))

    def mixture(self, which: int) -> tuple[Samples, Samples, Samples]:
        """One of these; of no modes where it is not known."""
        k = max(int(self.modes[which]), 0)
        return self.weights[which, :k], self.means[which, :k], self.covariances[which, :k]

    def forget(self, which: int) -> None:
        self.modes[which], self.cycles[which] = -1, 0
        self.limit[which] = self.full[which] = self.noise[which] = np.nan

    def put(self, which: int, refit: Refit) -> None:
        k = 0 if refit.unknown else refit.modes
        self.modes[which], self.cycles[which] = k, refit.cycles
        for mine, theirs in zip((self.weights, self.means, self.covariances), refit.mixture(), strict=True):
            mine[which, :k] = theirs[:k]


@kernel
def all_points(curves: Samples, slots: Times, group: Times, points: Samples) -> int:
    """Every point of a group's curves (place in %, height) into `points`; returns how many."""
    found = 0
    for slot in slots:
        for muscle in group:
            if not np.isnan(curves[slot, 0, muscle]):
                for p in range(curves.shape[1]):
                    points[found, 0], points[found, 1] = p, curves[slot, p, muscle]
                    found += 1
    return found


@dataclass(slots=True)
class ReferenceFit:
    """Makes one mixture's reference, a few sweeps at a time: the mixture of all cycles, of all points, of noise, and of random halves.

    task      what `refit` is about: OWN, FULL, NOISE, then the halves in turn;  half: the first half's mixture
    distances (pairs,)   between halves
    """

    refit: Refit
    task: int
    begun: bool
    half: References
    distances: Samples

    @staticmethod
    def empty(cycles: int, muscles: int, pairs: int) -> ReferenceFit:
        room = Refit.empty(cycles, muscles, cycles * muscles * POINTS)
        return ReferenceFit(room, 0, False, References.empty(1), np.full(pairs, np.nan))

    def go_on(
        self, window: PeakWindow, slots: Times, group: Times, which: int, size: int, out: References, how: Fitting
    ) -> bool:
        """One step of the reference `which` of a group's cycles at `slots`, into `out`; whether it is done. One part has `size` cycles."""
        if not self.begun:
            self._begin(window, slots, group, which, size, out, how)
            self.begun = True
        if not (self.refit.go_on(how) if self.task < FIRST_HALF else self.refit.sweep(how)):
            return False
        self._note(which, out, how.turns)
        self.begun = False
        self.task += 1
        if self.task < FIRST_HALF + 2 * len(self.distances) and out.modes[which] > 0:
            return False
        known = self.distances[np.isfinite(self.distances)]
        if 2 * len(known) > len(self.distances):
            out.limit[which] = chance_limit(known, len(slots) / size)
        self.abandon()
        return True

    def abandon(self) -> None:
        """Leave the reference under way."""
        self.begun, self.task, self.distances[:] = False, 0, np.nan

    def _begin(
        self, window: PeakWindow, slots: Times, group: Times, which: int, size: int, out: References, how: Fitting
    ) -> None:
        if self.task < FIRST_HALF:
            self.refit.begin(window, slots, group, how)
        if self.task in (FULL, NOISE):
            self.refit.count = all_points(window.curves, slots[:FULL_CYCLES], group, self.refit.points)
            if self.task == NOISE:
                heights = self.refit.points[: self.refit.count, 1]
                chance = np.random.Generator(np.random.Philox(key=[which, NOISE]))
                heights[:] = chance.normal(heights.mean(), heights.std(), len(heights))
            self.refit.active = -np.inf
            self.refit.restart(how)
        if self.task >= FIRST_HALF:
            pair, other = divmod(self.task - FIRST_HALF, 2)
            order = np.random.Generator(np.random.Philox(key=[which, FIRST_HALF + pair])).permutation(len(slots))
            half = slots[np.sort(order[size:] if other else order[:size])]
            self.refit.begin_from(window, half, group, how, out.mixture(which))

    def _note(self, which: int, out: References, turns: int) -> None:
        if self.task == OWN:
            out.put(which, self.refit)
            return
        made = self.refit.mixture()
        if self.task == FULL:
            out.full[which] = out.distance(which, made, turns)
        elif self.task == NOISE:
            out.noise[which] = out.distance(which, made, turns)
        elif (self.task - FIRST_HALF) % 2 == 0:
            self.half.put(0, self.refit)
        else:
            self.distances[(self.task - FIRST_HALF) // 2] = self.half.distance(0, made, turns)


def chance_limit(distances: Samples, windows: float) -> float:
    """What a window like those of the reference exceeds in one of a hundred cases, from distances (n,) between parts of one reference.

    It is the 99 % prediction limit (Student's t) of the cube roots, as a sum of squares has nearly normal ones (Wilson and Hilferty 1931),
    known from as many windows as the reference's cycles fill: `windows`. The largest two of a hundred distances say less of the
    percentile: limits taken from them alone scatter twice as much from reference to reference, and a low one costs false alarms.
    """
    roots = np.cbrt(distances)
    far = student(windows - 1.0) * np.sqrt(1.0 + 1.0 / windows)
    return float(max(roots.mean() + far * roots.std(), 0.0) ** 3)


@cache
def student(freedom: float) -> float:
    """The 99 % quantile of Student's t with `freedom` degrees of freedom (any positive number)."""
    return _student(freedom)


@remembered
def _student(freedom: float) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, SHARE))
