"""Whether images show the moment that their stamps say: what moves in them moves where the outline in the depth moves, at the same time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import structlog
from numpy.typing import NDArray

from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec
from kinegraph.stream.kernel import kernel

log = structlog.get_logger(__name__)

REACH_S, LEAST_REACH = 0.2, 3
"""Lags up to this are looked for; at least this many frames."""
GAP_S = 0.25
"""After a longer gap what moved before is no longer compared."""
MEMORY, ENOUGH = 60, 30
"""Evidence fades over MEMORY frames in which the outline moved; ENOUGH of them suffice to judge."""
LEAST_PIXELS, MOST_SHARE = 20, 0.5
"""A frame is evidence if at least this many pixels changed between person and room, and no more than this share of the person."""
OUT_S = 0.05
"""Half of what is a fault: exposure and readout alone are shorter."""
CLEARER = 1.15
"""How much better another lag must fit than lag 0. Rendered people: 1.3 and more (walking towards the camera is worst)."""


@dataclass(slots=True)
class InStep:
    """State of the newest 2 r + 1 pairs (a ring, the newest at `at`), and their results.

    image   (h, w)             the newest image
    person  (h, w)             where the person was in the newest depth frame
    light   (2 r + 1, h, w)    by how much the image had changed
    swept   (2 r + 1, h, w)    which pixels the outline had swept
    times   (2 r + 1,)         their stamps
    scores  (2 r + 1,)         the images' changes where the outline moved r frames earlier, ..., r later
    at      where the newest pair is
    count   how many pairs there are without a gap, at most 2 r + 2 (the first one shows no change)
    frames  of how many frames the scores are, at most ENOUGH
    out     whether images are out of step
    """

    image: NDArray[np.uint8]
    person: NDArray[np.uint8]
    light: NDArray[np.uint8]
    swept: NDArray[np.uint8]
    times: NDArray[np.int64]
    scores: Samples
    at: int
    count: int
    frames: int
    out: bool

    @classmethod
    def for_frames(cls, spec: StreamSpec) -> InStep:
        """For depth frames of this spec and images as large."""
        n = 2 * max(LEAST_REACH, round(REACH_S * (spec.rate_hz or 30.0))) + 1
        one, many = np.zeros((2, *spec.shape), np.uint8), np.zeros((2, n, *spec.shape), np.uint8)
        return cls(one[0], one[1], many[0], many[1], np.zeros(n, np.int64), np.zeros(n), 0, 0, 0, False)

    def watch(self, time: int, depth: Array, image: Array) -> bool:
        """A depth frame of the person alone, and its image (h, w[, channels]); whether images can be believed to be of their time."""
        n = len(self.times)
        if time - self.times[self.at] > GAP_S * NS:
            self.count = 0
        self.at = at = (self.at + 1) % n
        self.times[at], self.count = time, min(self.count + 1, n + 1)
        grey = image if image.ndim == 2 else image[..., image.shape[2] // 2]
        swept, pixels = changes(depth, grey, self.person, self.image, self.light[at], self.swept[at])
        if not LEAST_PIXELS <= swept <= MOST_SHARE * pixels:
            self.swept[at] = 0
        if self.count > n:
            self._judge((at - n // 2) % n)
        return not self.out

    def _judge(self, middle: int) -> None:
        """Hold the outline's movement in pair `middle`, in the middle of the ring's time, against all images of the ring."""
        n = len(self.times)
        fits = np.zeros(n)
        overlap(self.swept[middle], self.light, self.at + 1, fits)
        if not fits.any():
            return
        self.scores *= 1.0 - 1.0 / MEMORY
        self.scores += fits / fits.max()
        self.frames = min(self.frames + 1, ENOUGH)
        lags_s = (np.roll(self.times, -self.at - 1) - self.times[middle]) / NS
        best, near = int(self.scores.argmax()), np.abs(lags_s) < OUT_S
        out = not near[best] and self.scores[best] > CLEARER * self.scores[near].max()
        if self.frames < ENOUGH or out == self.out:
            return
        if out or self.scores[near].max() > CLEARER * self.scores[~near].max():
            self.out = out
            self._report(float(lags_s[best]))

    def _report(self, lag_s: float) -> None:
        if not self.out:
            log.warning("images are in step with the depth again")
            return
        log.warning(
            "images are out of step with the depth that has their stamps: the body is tracked without them until they are in step again",
            shown_ms=f"{abs(1000 * lag_s):.0f} {'earlier' if lag_s > 0 else 'later'}",
        )


@kernel(nogil=True)
def changes(
    depth: NDArray[np.uint16],
    image: NDArray[np.uint8],
    person: NDArray[np.uint8],
    before: NDArray[np.uint8],
    light: NDArray[np.uint8],
    swept: NDArray[np.uint8],
) -> tuple[int, int]:
    """How much `image` (h, w) differs from the one `before`, into `light`; where `depth` shows a person and `person` says not, or the
    other way round, into `swept`. Both memories are renewed. Returns how many pixels were swept, and how many are the person's."""
    moved, pixels = 0, 0
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            a, b = image[y, x], before[y, x]
            light[y, x] = a - b if a > b else b - a
            before[y, x] = a
            here = np.uint8(depth[y, x] > 0)
            swept[y, x] = here != person[y, x]
            person[y, x] = here
            moved += int(swept[y, x])
            pixels += int(here)
    return moved, pixels


@kernel(nogil=True)
def overlap(swept: NDArray[np.uint8], light: NDArray[np.uint8], oldest: int, out: Samples) -> None:
    """How much every image of the ring `light` (n, h, w) changed where the outline swept (h, w), into `out` (n,), the `oldest` first."""
    n = len(out)
    for y in range(swept.shape[0]):
        for x in range(swept.shape[1]):
            if swept[y, x]:
                for k in range(n):
                    out[k] += light[(oldest + k) % n, y, x]
