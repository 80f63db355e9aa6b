"""Co-contraction: how much of the activity of two muscles they have at the same time (Falconer and Winter 1985)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.cycles.statistics.ensemble_events import PAIR, rows_of
from kinegraph.stream.chunk import Array, Samples, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError, nearest


@dataclass(slots=True)
class CoContraction:
    """
    names, muscles (2 p,)  of the pairs' muscles, one pair after another; their channels
    shared, cycles (p,)    sum of the co-contraction over cycles, and their number, per pair
    """

    names: list[str]
    muscles: list[int]
    shared: Samples
    cycles: Samples

    @staticmethod
    def of(pairs: tuple[tuple[str, str], ...], spec: StreamSpec) -> CoContraction:
        """Of cycles that are normalised in amplitude. Raises InputError, or ParameterError for `pairs`."""
        names = [name for pair in pairs for name in pair]
        for name in names:
            if name not in spec.channels:
                raise ParameterError("pairs", name, f"one of the muscles; {nearest(name, spec.channels)}")
        if any(a == b for a, b in pairs):
            raise ParameterError("pairs", [list(pair) for pair in pairs], "pairs of two different muscles")
        if names and spec.meta.get("normalisation", "none") == "none":
            raise InputError(
                "cycles",
                f"not normalised in amplitude (in {', '.join(dict.fromkeys(spec.units)) or 'no unit'})",
                "normalised for `pairs`, since co-contraction compares two muscles (operators.emg.normalise.Normalise before the cycles)",
            )
        muscles = [spec.channels.index(name) for name in names]
        return CoContraction(names, muscles, np.zeros(len(pairs)), np.zeros(len(pairs)))

    def add(self, closed: Array, curve: Samples) -> Array:
        """Take one more cycle in; an event (`PAIR`) per pair."""
        rows = rows_of(PAIR, closed, len(self.cycles))
        if not self.names:
            return rows
        index = self._of_cycle(curve)
        known = np.isfinite(index)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.shared[known] += index[known]
            self.cycles[known] += 1
            rows["mean_pct"] = self.shared / self.cycles
        rows["first"], rows["second"] = self.names[::2], self.names[1::2]
        rows["co_contraction_pct"], rows["cycles"] = np.where(known, index, np.nan), self.cycles
        return rows

    def remove(self, curve: Samples) -> None:
        """Take out a cycle that was added."""
        index = self._of_cycle(curve)
        known = np.isfinite(index)
        self.shared[known] -= index[known]
        self.cycles[known] -= 1

    def _of_cycle(self, curve: Samples) -> Samples:
        """2 sum min(a, b) / sum (a + b) of each pair (p,) in a cycle, in %."""
        a, b = curve[:, self.muscles[::2]], curve[:, self.muscles[1::2]]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(200 * np.minimum(a, b).sum(axis=0) / (a + b).sum(axis=0))
