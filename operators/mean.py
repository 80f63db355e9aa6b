"""Removal of the mean: of a moving window, of everything so far, or of the beginning."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from operators.continuity import Continuity, Filter, nothing, numeric, regular, rows, samples_in, watch
from operators.moving import slide, two_sum
from stream.chunk import Chunk, Samples, Specs, StreamSpec, Times
from stream.kernel import kernel
from stream.operator import Case, Step, grid
from stream.params import param


@kernel
def less_moving_mean(x: Samples, ring: Samples, sums: Samples, places: Times, out: Samples) -> None:
    """`x` (n, c) less the mean of the newest values, the present one included; see `moving.slide` for the memory."""
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = x[i, c] if abs(x[i, c]) < math.inf else math.nan
        slide(out[i], ring, sums, places)
        for c in range(x.shape[1]):
            out[i, c] = x[i, c] - out[i, c]


@kernel
def less_running_mean(x: Samples, most: int, sums: Samples, places: Times, out: Samples) -> None:
    """`x` (n, c) less the mean of the first `most` values so far (0: of all), the present one included.

    `sums` (4, c) holds the sum and its remainder in its first two rows, `places` (2, c) how many values it counts in its second.
    """
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            v = x[i, c]
            if not abs(v) < math.inf:
                out[i, c] = math.nan
                continue
            if most == 0 or places[1, c] < most:
                sums[0, c], sums[1, c] = two_sum(sums[0, c], sums[1, c], v)
                places[1, c] += 1
            out[i, c] = v - sums[0, c] / places[1, c]


@dataclass(slots=True)
class RemoveMeanState(Continuity):
    ring: Samples
    sums: Samples
    places: Times
    most: int


@dataclass(frozen=True, slots=True)
class RemoveMean(Filter[RemoveMeanState]):
    """Each number less a mean of what came up to it. Stamps unchanged, no delay.

    moving   the mean of the newest `window_s`, the present sample included: a simple high-pass, for offsets that wander
    running  the mean of everything since the start (or since a gap that resets); exact, however long it runs
    initial  the mean of the first `window_s`, kept from then on: a baseline taken at rest. Until it is complete: the mean so far

    Sums are kept as in MovingMean, so nothing drifts. A window holds a number of samples, `window_s` times the rate, rounded.
    """

    mean: Literal["moving", "running", "initial"] = param("moving", help="which mean is removed")
    window_s: float = param(1.0, above=0.0, help="over how long the moving or initial mean is taken")
    reset_gap_s: float = param(0.1, least=0.0, help="a longer gap makes all means begin anew")

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        rate_hz = regular(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        seen = watch(specs["in"], reset_gap_s=self.reset_gap_s)
        c = seen["width"]
        state = RemoveMeanState(
            **seen,
            ring=np.zeros((w if self.mean == "moving" else 0, c)),
            sums=np.zeros((4, c)),
            places=np.zeros((2, c), np.int64),
            most=w if self.mean == "initial" else 0,
        )
        self.hold(state)
        return {"out": spec.derive(settling_s=spec.settling_s + (w - 1) / rate_hz)}

    def kernel_step(self) -> Step:
        state, kernel = self.state, less_moving_mean if self.mean == "moving" else less_running_mean
        return Step(kernel, state, last=state.last)

    def rest(self) -> None:
        self.state.sums[:] = 0.0
        self.state.places[:] = 0

    def process(self, port: str, chunk: Chunk) -> Chunk:
        state = self.state
        if not len(chunk.time):
            return nothing(chunk, state)
        if chunk.lost and state.breaks(chunk):
            self.rest()
        state.last[0] = chunk.time[-1]
        x = chunk.data
        made: Samples = np.empty(x.shape)
        out = made
        if not state.plain:
            x, out = rows(x, state.width), made.reshape(len(x), state.width)
        if self.mean == "moving":
            less_moving_mean(x, state.ring, state.sums, state.places, out)
        else:
            less_running_mean(x, state.most, state.sums, state.places, out)
        return Chunk(chunk.time, made, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(6).normal(size=(500, 3)) + np.array([0.0, 5.0, -100.0])
        inputs = {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 500), data)}
        return [
            Case(cls(), inputs, least=500),
            Case(cls(mean="running"), inputs, least=500),
            Case(cls(mean="initial", window_s=0.5), inputs, least=500),
        ]
