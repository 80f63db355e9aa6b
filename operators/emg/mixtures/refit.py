"""Refits a mixture in small pieces: starts from the window's peaks, sweeps a few times per sample, then merges and emits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS
from kinegraph.operators.emg.mixtures.distance import merge_close_modes
from kinegraph.operators.emg.mixtures.events import MOST_MODES
from kinegraph.operators.emg.mixtures.kernel import CYCLE, begin_mixture, cluster_places, fit
from kinegraph.operators.emg.mixtures.peak_window import MOST_PEAKS, PeakWindow, gather, keep_active, least_activity
from kinegraph.operators.emg.mixtures.peaks_kernel import find_peaks
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

UNKNOWN = ("", "too few cycles", "no burst", "too few peaks", "rest")
FEW_CYCLES, NO_BURST, FEW_PEAKS, REST = 1, 2, 3, 4
FEWEST_PEAKS = 3
SWEEPS, OF_PEAKS = 24, 250
"""Sweeps of one call: 24 for the 250 peaks of twenty cycles, which takes under a millisecond; of more points, as many fewer."""


@dataclass(slots=True)
class Fitting:
    """How a mixture is fitted. `least` of a mode: its spread along the cycle in %, and its height as a share of the mean curve's peak.
    Peaks below `rest_sd` and `of_peak` are rest (`least_activity`).

    Recordings hold the names of these fields: `Fitting(**meta["fitting"])` reads them.
    """

    width: int
    passes: int
    least_depth: float
    circular: bool
    tolerance: float
    most_sweeps: int
    closer: float
    least_pct: float
    least_height: float
    contrast: float
    fewest_cycles: int
    rest_sd: float
    of_peak: float

    @property
    def turns(self) -> int:
        return 1 if self.circular else 0


def contrast_of(mean: Samples) -> float:
    """How many times the mean curve's median its peak is; infinite where the median is not above 0."""
    middle = float(np.median(mean))
    return float(mean.max()) / middle if middle > 0.0 else np.inf


@kernel
def start(
    points: Samples, mean: Samples, active: float, width: int, passes: int, depth: float, circular: bool, least: Samples,
    weights: Samples, means: Samples, covariances: Samples,
) -> int:  # fmt: skip
    """The first mixture, by the peaks of the mean curve that are `active` (so high), and k-means along the cycle; returns its number of
    modes."""
    places = np.empty(weights.shape[0])
    every = find_peaks(mean, width, passes, depth, circular, places, np.empty((2, mean.shape[0])))
    found = 0
    for i in range(every):
        if mean[int(places[i])] >= active:
            places[found] = places[i]
            found += 1
    if found == 0:
        places[0], found = float(np.argmax(mean)), 1
    chosen = np.empty(points.shape[0])
    cluster_places(points[:, 0].copy(), places[:found], circular, 100, chosen)
    return begin_mixture(points, chosen, places[:found], circular, least, weights, means, covariances)


def highest_apart(means: Samples, count: int) -> float:
    """The circular distance along the cycle of the two highest modes (thesis eq. 6.7); NaN below two."""
    if count < 2:
        return np.nan
    first, second = np.argsort(-means[:count, 1], kind="stable")[:2]
    apart = abs(float(means[first, 0] - means[second, 0]))
    return float(min(apart, CYCLE - apart))


@dataclass(slots=True)
class Refit:
    """One mixture on its way.

    points (most, 2) of which `count`;  mean (100,): the mean curve;  cycles: how many curves it is of
    weights, means, covariances (16, ...) of which `modes`;  sweeps, before: how far EM has come;  settled: whether it has ended by itself
    unknown   why there is no mixture, as an index into `UNKNOWN`; 0 while there is one
    """

    points: Samples
    mean: Samples
    least: Samples
    weights: Samples
    means: Samples
    covariances: Samples
    scratch: Samples
    count: int
    cycles: int
    modes: int
    sweeps: int
    before: float
    settled: bool
    unknown: int
    active: float
    resting: int

    @staticmethod
    def empty(cycles: int, muscles: int, extra: int = 0) -> Refit:
        """With room for `cycles` cycles of `muscles` muscles in one mixture, and `extra` points."""
        room = cycles * muscles * MOST_PEAKS + extra
        k = MOST_MODES
        return Refit(
            np.zeros((room, 2)), np.zeros(POINTS), np.zeros(2), np.zeros(k), np.zeros((k, 2)), np.zeros((k, 3)),
            np.zeros((k, 13)), 0, 0, 0, 0, -np.inf, True, 0, -np.inf, 0,
        )  # fmt: skip

    def begin(self, window: PeakWindow, slots: Times, group: Times, how: Fitting) -> None:
        """Start with the peaks of a group of muscles in the cycles at `slots`."""
        self._gather(window, slots, group, how)
        self.restart(how)

    def restart(self, how: Fitting) -> None:
        """Start with the points and the mean curve that are there."""
        self.modes, self.sweeps, self.before, self.settled = 0, 0, -np.inf, False
        top = float(self.mean.max())
        if self.cycles < how.fewest_cycles:
            self.unknown = FEW_CYCLES
        elif not top > 0.0 or contrast_of(self.mean) < how.contrast:
            self.unknown = NO_BURST
        elif self.count < FEWEST_PEAKS:
            self.unknown = REST if self.count + self.resting >= FEWEST_PEAKS else FEW_PEAKS
        else:
            self.unknown = 0
            self.least[:] = how.least_pct**2, (how.least_height * top) ** 2
            self.modes = start(
                self.points[: self.count], self.mean, self.active, how.width, how.passes, how.least_depth, how.circular, self.least,
                self.weights, self.means, self.covariances,
            )  # fmt: skip
        self.settled = bool(self.unknown)

    def begin_from(
        self, window: PeakWindow, slots: Times, group: Times, how: Fitting, start: tuple[Samples, Samples, Samples]
    ) -> None:
        """Start with the peaks of these cycles, from another mixture of the same muscles: the same modes, wherever they have gone.

        A fit from scratch finds now one mode more, now one less, and so jumps without cause.
        """
        self._gather(window, slots, group, how)
        self.modes, self.sweeps, self.before, self.settled = len(start[0]), 0, -np.inf, False
        self.unknown = FEW_CYCLES if self.cycles < 2 else FEW_PEAKS if self.count < FEWEST_PEAKS else 0
        if self.unknown:
            self.modes, self.settled = 0, True
            return
        for mine, theirs in zip((self.weights, self.means, self.covariances), start, strict=True):
            mine[: self.modes] = theirs
        self.least[:] = how.least_pct**2, (how.least_height * float(self.mean.max())) ** 2

    def _gather(self, window: PeakWindow, slots: Times, group: Times, how: Fitting) -> None:
        """Take the peaks of these cycles that are activity, and their mean curve."""
        every, self.cycles = gather(window.curves, window.peaks, window.tops, slots, group, self.points, self.mean)
        self.active = least_activity(window.curves, slots, group, self.mean, how.rest_sd, how.of_peak)
        self.count = keep_active(self.points, every, self.active)
        self.resting = every - self.count

    def follow(
        self, window: PeakWindow, slots: Times, group: Times, how: Fitting, start: tuple[Samples, Samples, Samples]
    ) -> None:
        """`begin_from`, and fit to the end."""
        self.begin_from(window, slots, group, how, start)
        while not self.sweep(how):
            pass

    def sweep(self, how: Fitting) -> bool:
        """A call's worth of sweeps; whether there are no more to come."""
        if self.unknown:
            return True
        k = self.modes
        most = max(1, SWEEPS * OF_PEAKS // max(self.count, OF_PEAKS))
        done, self.before, self.settled = fit(
            self.points[: self.count], self.weights[:k], self.means[:k], self.covariances[:k],
            how.turns, self.least, how.tolerance, min(most, how.most_sweeps - self.sweeps), self.before, self.scratch[:k],
        )  # fmt: skip
        self.sweeps += done
        return self.settled or self.sweeps >= how.most_sweeps

    def go_on(self, how: Fitting) -> bool:
        """A call's worth of sweeps; whether the mixture is done, with close modes merged."""
        if not self.sweep(how):
            return False
        if not self.unknown:
            self._tidy(how)
        return True

    def finish(self, how: Fitting) -> None:
        while not self.go_on(how):
            pass

    def most_calls(self, most_sweeps: int) -> int:
        """How many calls of `go_on` a mixture takes at most."""
        return -(-most_sweeps // max(1, SWEEPS * OF_PEAKS // max(len(self.points), OF_PEAKS)))

    def mixture(self) -> tuple[Samples, Samples, Samples]:
        k = self.modes
        return self.weights[:k], self.means[:k], self.covariances[:k]

    def _tidy(self, how: Fitting) -> None:
        """Drop modes that account for nothing, merge those too close to be two, and put the highest first."""
        keep = np.flatnonzero(self.weights[: self.modes] * self.count > 1e-6)
        self._keep(keep)
        if how.closer > 0.0:
            self.modes = merge_close_modes(
                self.weights, self.means, self.covariances, self.modes, how.closer, how.circular
            )
        self._keep(np.argsort(-self.means[: self.modes, 1], kind="stable"))

    def _keep(self, chosen: Times) -> None:
        self.modes = n = len(chosen)
        for part in (self.weights, self.means, self.covariances):
            part[:n] = part[chosen]
            part[n:] = 0.0
