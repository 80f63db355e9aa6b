"""Feature bundling as frames come (thesis 2.2): frames at the same stage of a movement are drawn together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.features.bundle_kernel import NUMBERS, BundleMemory, bundle_frames
from kinegraph.operators.features.stack import pieces
from kinegraph.operators.inputs.continuity import Continuity, watch
from kinegraph.operators.neighbours.index import LIMITS
from kinegraph.operators.neighbours.layout import IndexState, allocate, clear
from kinegraph.stream.chunk import FOREVER, Chunk, Specs, StreamSpec
from kinegraph.stream.data.require import numeric, regular, samples_in
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

APART = 4
"""Frames further apart than this many periods are not neighbours in time."""


@dataclass(slots=True)
class BundleState(Continuity):
    """What is known of the input, of its frames so far, and of the newest ones."""

    index: IndexState
    memory: BundleMemory


@dataclass(frozen=True, slots=True)
class Bundle(Operator[BundleState]):
    """Frames of features (width,) in, the same bundled out: noise and variation across the way of a movement go, its timing stays.

    For each frame: its k nearest among those of the newest `window_s`, up to `ahead` frames after it; its direction of movement (five-point
    derivative); across that, the principal components which hold `variance` of the neighbours; there the nearest maximum of their
    density (Gaussian kernels, Scott's bandwidth).

    Delay: `ahead` frames, the last of which are not emitted. A frame with a bad value, or with an unknown direction (two frames
    beside the start or a gap of more than three frames, four beside a bad value), is emitted unchanged.

    Departures from the thesis: the density's maximum is sought, not its minimum as equation 2.4 prints; neighbours are those known by then,
    not of the whole recording, so that the first cycles of a movement are drawn together less; instead of random directions made
    orthogonal, what lies along the movement is taken off, which spans the same space and is the same every time.

    >>> given, made = tried(Bundle)
    >>> given["in"][100, :3].round(2), made[100, :3].round(2)
    (array([-1.08, -0.29,  0.45]), array([-1.07, -0.31,  0.46]))
    """

    exemptions: ClassVar[dict[str, str]] = {
        "channels": "a frame with a bad value has no neighbours, and is no neighbour"
    }

    inputs = {"in": Input(rows=True)}
    k: int = param(32, least=4, most=128, help="how many neighbours")
    window_s: float = param(60.0, above=0.0, help="how far back to search for neighbours")
    variance: float = param(0.975, above=0.0, most=1.0, help="share of the neighbours' variance that is kept")
    ahead: int = param(2, least=2, most=1000, help="frames that are awaited: the delay")
    reset_gap_s: float = reset_gap(60.0)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        out = numeric(spec)
        most = LIMITS["width"][1]
        if not spec.is_signal or not 2 <= spec.shape[0] <= most:
            raise InputError("in", spec.describe(), f"a signal of 2 to {most} features")
        rate_hz = regular(spec)
        window = samples_in("window_s", self.window_s, rate_hz)
        if not self.k + self.ahead < window <= LIMITS["window"][1]:
            least = (self.k + self.ahead + 1) / rate_hz
            raise ParameterError("window_s", self.window_s, f"from {least:g} to {LIMITS['window'][1] / rate_hz:g}")
        d, k = spec.shape[0], self.k
        memory = BundleMemory(
            numbers=np.zeros((), NUMBERS),
            recent=np.zeros((self.ahead + 3, d)),
            past=np.zeros((2, self.ahead + 1), np.int64),
            ways=np.zeros((3, max(d, k))),
            pull=np.zeros((d, k)),
            gram=np.zeros((k, k)),
            basis=np.zeros((k, k)),
            values=np.zeros(k),
            rest=np.zeros(k),
            weights=np.zeros(k),
            aside=np.zeros(k),
            here=np.zeros(k),
        )
        memory.k, memory.variance, memory.ahead, memory.furthest = k, self.variance, self.ahead, APART * spec.period_ns
        continuity = watch(spec, delay_s=self.ahead / rate_hz, reset_gap_s=self.reset_gap_s)
        state = BundleState(**continuity, index=allocate(d, window, k), memory=memory)
        self.set_state(state, delay_s=self.ahead / rate_hz)
        return {"out": out.derive(meta={**spec.meta, "bundled": {"k": k, "variance": self.variance}})}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        s = self.state
        n = len(chunk.time)
        out, when = np.empty((n, s.width)), np.empty((2, n), np.int64)
        made = 0
        if n:
            if chunk.lost and s.breaks(chunk):
                clear(s.index)
            s.last[0] = chunk.time[-1]
            index = s.index
            made = bundle_frames(index.floats, index.books, s.memory, chunk.data, chunk.time, chunk.lost, out, when)
        return pieces(when[0, :made], out[:made], when[1, :made], self._promise(chunk.until))

    def _promise(self, until: int) -> int:
        """No later frame comes out with a stamp at or before this: not before the oldest that still waits."""
        memory = self.state.memory
        waiting = min(memory.frames, self.ahead)
        if until == FOREVER or not waiting or until - self.state.last.item(0) > memory.furthest:
            return until
        return min(until, int(memory.past[0, self.ahead + 1 - waiting]) - 1)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(33)
        phase = np.arange(260) * 0.3
        x = np.stack([np.sin(phase + i) for i in range(6)], 1) + 0.1 * rng.normal(size=(260, 6))
        spec = StreamSpec((6,), rate_hz=30.0, units=("cm",))
        return [
            Case(cls(k=12, window_s=5.0), {"in": (spec, grid(30.0, 260), x)}, least=250),
            Case(cls(k=6, window_s=2.0, ahead=9), {"in": (spec, grid(30.0, 260), x.astype(np.float32))}, least=240),
        ]
