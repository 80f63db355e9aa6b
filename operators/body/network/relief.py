"""A person's depth as an image that a pose network understands: the body's surface, lit from the side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

GREY = 128


@kernel(nogil=True)
def light(frame: NDArray[np.uint16], reach: int, smooth: Samples, out: NDArray[np.uint8]) -> None:
    """Renders `frame` (h, w) in mm, 0 outside the person, lit from the upper left on grey, into `out` (h, w). `smooth` (h, w) is room."""
    h, w = frame.shape
    for y in range(h):
        for x in range(w):
            out[y, x], smooth[y, x] = GREY, 0.0
            d = float(frame[y, x])
            if d == 0.0:
                continue
            total, n = 0.0, 0
            for v in range(max(0, y - reach), min(h, y + reach + 1)):
                for u in range(max(0, x - reach), min(w, x + reach + 1)):
                    if frame[v, u] != 0 and abs(frame[v, u] - d) < 80.0:
                        total += frame[v, u]
                        n += 1
            smooth[y, x] = total / n
    for y in range(1, h - 1):
        for x in range(1, w - 1):
            d = smooth[y, x]
            if d == 0.0:
                continue
            right, left = smooth[y, x + 1], smooth[y, x - 1]
            under, over = smooth[y + 1, x], smooth[y - 1, x]
            p = ((right if right != 0.0 else d) - (left if left != 0.0 else d)) / (d / 140.0)
            q = ((under if under != 0.0 else d) - (over if over != 0.0 else d)) / (d / 140.0)
            bright = (0.8 + 0.5 * p + 0.35 * q) / np.sqrt(1.0 + p * p + q * q)
            out[y, x] = np.uint8(min(max(60.0 + 150.0 * bright, 1.0), 255.0))


@dataclass(slots=True)
class ReliefState:
    smooth: Samples


@dataclass(frozen=True, slots=True)
class Relief(Operator[ReliefState]):
    """Depth of a person in (0 elsewhere), a grey image of the body's surface under light from the side out: (height, width) uint8.

    For a pose network without a camera image: it protects the person's identity, and works in the dark.

    >>> slope = np.arange(1000, 1400, 50, np.uint16)[None, None, :].repeat(8, axis=1)
    >>> Relief()(slope, rate_hz=30, units=["mm"])[0, 4].tolist()
    [128, 146, 144, 144, 144, 145, 149, 128]
    """

    reach: int = param(2, least=0, most=5, help="depth is smoothed over this many pixels to each side")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != np.uint16 or len(spec.shape) != 2:
            raise InputError("in", spec.describe(), "depth frames (height, width) uint16 in mm, 0 outside the person")
        self.set_state(ReliefState(np.zeros(spec.shape)))
        return {"out": spec.derive(dtype=np.dtype(np.uint8), units=("",))}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        out = np.empty(chunk.data.shape, np.uint8)
        for i in range(len(chunk)):
            light(chunk.data[i], self.reach, self.state.smooth, out[i])
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        frames = np.zeros((20, 24, 32), np.uint16)
        frames[:, 4:20, 8:20] = np.random.default_rng(2).integers(1900, 2100, (20, 16, 12))
        spec = StreamSpec((24, 32), np.dtype(np.uint16), rate_hz=30.0, units=("mm",))
        return [Case(cls(), {"in": (spec, grid(30.0, 20), frames)}, least=20)]
