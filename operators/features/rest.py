"""Rest: while nothing has moved for a while, nothing passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.features.stack import pieces
from kinegraph.operators.filters.extremes import moving_extreme
from kinegraph.operators.inputs.continuity import Continuity, watch
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times, add_lost
from kinegraph.stream.data.require import numeric, regular, samples_in
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param


@dataclass(slots=True)
class RestState(Continuity):
    """Queues of the largest and of the smallest values (as in operators.filters.extremes); samples seen, and those kept
    back for the next one."""

    queue: Samples
    numbers: Times
    places: Times
    seen: int
    dropped: int


@dataclass(frozen=True, slots=True)
class SkipRest(Operator[RestState]):
    """Drops samples while no channel has moved by more than `moves` within the newest `window_s`.

    What is kept back counts as lost, so that what follows sees a gap: somebody sat down, or put the phone on the table. Movement passes
    from its first sample beyond `moves` on. The first `window_s` pass, also after a gap. A sample with a bad value passes, as NaN. No
    delay.

    >>> walk_and_stand = np.concatenate([np.arange(10.0), np.full(30, 9.0)])
    >>> len(SkipRest(moves=0.5, window_s=1.0)(walk_and_stand, rate_hz=10))
    18
    """

    exemptions: ClassVar[dict[str, str]] = {"channels": "rest is that of all channels together"}
    inputs = {"in": Input(finite=True)}
    moves: float = param(above=0.0, help="what moves less is at rest, in the signal's unit")
    window_s: float = param(2.0, above=0.0, help="for how long nothing must have moved")
    reset_gap_s: float = reset_gap(0.5)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        out = numeric(spec)
        w = samples_in("window_s", self.window_s, regular(spec))
        seen = watch(spec, reset_gap_s=self.reset_gap_s)
        wide = (2, w, seen["width"])
        places = np.zeros((2, 3, seen["width"]), np.int64)
        self.set_state(
            RestState(**seen, queue=np.zeros(wide), numbers=np.zeros(wide, np.int64), places=places, seen=0, dropped=0)
        )
        return {"out": out}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        s = self.state
        if not len(chunk):
            return Chunk(chunk.time, s.nothing, chunk.until)
        if chunk.lost and s.breaks(chunk):
            s.places[:] = 0
            s.seen = 0
        s.last[0] = chunk.time[-1]
        x = chunk.data
        passes = ~self._at_rest(x, chunk.time)
        lost = np.zeros(len(chunk), np.int64)
        kept = add_lost(s.dropped, chunk.lost)
        for i, moving in enumerate(passes):
            lost[i], kept = (kept, 0) if moving else (0, add_lost(kept, 1))
        s.dropped = kept
        made = x[passes].reshape(-1, *s.nothing.shape[1:])
        return pieces(chunk.time[passes], made, lost[passes], chunk.until)

    def _at_rest(self, x: Samples, time: Times) -> Array:
        s = self.state
        extremes, stamps = np.empty((2, *x.shape)), np.empty(len(x), np.int64)
        for k, sign in enumerate((1.0, -1.0)):
            moving_extreme(x, sign, s.queue[k], s.numbers[k], s.places[k], time, 0, extremes[k], stamps)
        full = np.arange(s.seen, s.seen + len(x)) >= s.queue.shape[1] - 1
        s.seen = min(s.seen + len(x), s.queue.shape[1])
        still: Array = full & (extremes[0] - extremes[1] <= self.moves).all(axis=1)
        return still

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(8)
        moves = np.repeat([1.0, 0.0, 1.0, 0.0], [150, 250, 100, 100])
        x = moves[:, None] * np.sin(np.arange(600) * 0.2)[:, None] * [1.0, 2.0] + 0.02 * rng.normal(size=(600, 2))
        spec = StreamSpec((2,), rate_hz=100.0, units=("m/s2",))
        return [Case(cls(moves=0.3, window_s=0.5), {"in": (spec, grid(100.0, 600), x)}, least=300)]
