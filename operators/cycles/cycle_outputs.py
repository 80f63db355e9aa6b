"""What goes out of cycles that have been closed: curves, events, maxima, and each cycle with the halves of its neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.cycles.cycle import CLOSED, CLOSED_UNITS, MAXIMUM, POINTS, Closing
from kinegraph.operators.cycles.panorama import Panorama
from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec, Times

BLANK = {"cycles": np.dtype(np.float64), "closed": CLOSED, "maxima": MAXIMUM, "panorama": np.dtype(np.float64)}
PLACES = {name: k for k, name in enumerate(BLANK)}


@dataclass(slots=True)
class CycleOutputs:
    """
    names          of the channels
    never, blanks  stamps and samples of nothing, by output
    """

    names: list[str]
    panorama: Panorama
    never: Times
    blanks: list[Array]

    @staticmethod
    def of(names: list[str]) -> CycleOutputs:
        n = len(names)
        shapes: dict[str, tuple[int, ...]] = {"cycles": (POINTS, n), "panorama": (2 * POINTS, n)}
        blanks = [np.empty((0, *shapes.get(name, ())), kind) for name, kind in BLANK.items()]
        return CycleOutputs(names, Panorama.empty(POINTS, n), np.empty(0, np.int64), blanks)

    @staticmethod
    def specs(
        names: tuple[str, ...], signal: StreamSpec, closed: np.dtype[Any], longest_s: float, meta: dict[str, Any]
    ) -> Specs:
        """Of cycles of these channels, cut from `signal`; `closed`: what their events are, `CLOSED` and perhaps more behind."""
        unit = signal.units if len(signal.units) == 1 else ("",)
        more = ("",) * (len(closed.names or ()) - len(CLOSED_UNITS))
        curves = StreamSpec(
            (POINTS, len(names)), channels=names, units=signal.units, channel_axis=1, meta={**meta, "from_pct": 0}
        )
        return {
            "cycles": curves,
            "closed": StreamSpec((), closed, units=(*CLOSED_UNITS, *more), meta={**meta, "longest_s": longest_s}),
            "maxima": StreamSpec((), MAXIMUM, units=("ns", "", "", "", "%", *unit), meta=meta),
            "panorama": curves.derive(shape=(2 * POINTS, len(names)), meta={**meta, "from_pct": -50}),
        }

    def blank(self, name: str, until: int, lost: int = 0) -> Chunk:
        """Nothing, of an output."""
        return Chunk(self.never, self.blanks[PLACES[name]], until, lost)

    def chunks(self, closings: list[Closing], until: int, lost: int) -> list[tuple[str, Chunk]]:
        """A chunk for every output; an accepted cycle's event goes before its curve."""
        if not closings:
            return [(name, self.blank(name, until, lost)) for name in BLANK]
        n = len(self.names)
        accepted = [c for c in closings if not c.rejected]
        curves = np.array([c.curve[1:-1] for c in accepted]).reshape(-1, POINTS, n)
        closed = np.array([c.row() for c in closings], CLOSED)
        peaks = [c.maxima(self.names) for c in accepted]
        views = [
            (c.stamp, view)
            for c in closings
            if not c.again and (view := self.panorama.follow(None if c.rejected else c.curve[1:-1])) is not None
        ]
        panoramas = np.array([view for _, view in views]).reshape(-1, 2 * POINTS, n)
        when = _stamps([c.stamp for c in accepted])
        tops = np.concatenate([np.empty(0, MAXIMUM), *peaks])
        return [
            ("closed", Chunk(_stamps([c.stamp for c in closings]), closed, until, lost)),
            ("cycles", Chunk(when, curves, until, lost)),
            ("maxima", Chunk(when.repeat([len(p) for p in peaks]), tops, until, lost)),
            ("panorama", Chunk(_stamps([stamp for stamp, _ in views]), panoramas, until, lost)),
        ]


def _stamps(values: list[int]) -> Times:
    return np.array(values, np.int64)
