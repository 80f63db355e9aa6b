"""Two streams of frames brought together by their stamps: each frame of the second with the nearest one of the first."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec, Times

SPARE = 3
"""Room for this many frames more than come within the time that a partner is waited for."""


@dataclass(slots=True)
class Waiting:
    """Frames in the order of time: `frames` (most, ...), `times` and `lost` (most,), of which `count` are there."""

    frames: Array
    times: Times
    lost: Times
    count: int

    @classmethod
    def room_for(cls, spec: StreamSpec, apart_s: float) -> Waiting:
        most = SPARE + math.ceil(2 * apart_s * (spec.rate_hz or 60.0))
        return cls(np.zeros((most, *spec.shape), spec.dtype), np.zeros(most, np.int64), np.zeros(most, np.int64), 0)

    def add(self, frame: Array, time: int, lost: int) -> None:
        """One more; the oldest goes where there is no room."""
        if self.count == len(self.times):
            self.drop(1)
        self.frames[self.count], self.times[self.count], self.lost[self.count] = frame, time, lost
        self.count += 1

    def drop(self, n: int) -> None:
        """The oldest `n` go."""
        for kept in (self.frames, self.times, self.lost):
            kept[: self.count - n] = kept[n : self.count].copy()
        self.count -= n


@dataclass(slots=True)
class Pairing:
    """What waits for its partner: images, and depth frames with what is missing before each."""

    apart_ns: int
    images: Waiting
    depths: Waiting

    @classmethod
    def within(cls, apart_s: float, image: StreamSpec, depth: StreamSpec) -> Pairing:
        """Frames further apart than this are no pair."""
        return cls(round(apart_s * NS), Waiting.room_for(image, apart_s), Waiting.room_for(depth, apart_s))

    def take(self, waiting: Waiting, chunk: Chunk) -> list[tuple[int, int, Array, Array | None]]:
        """Take frames; returns (stamp, lost, depth, image or None) of every depth frame with a known partner."""
        found = []
        for i, time in enumerate(chunk.time.tolist()):
            waiting.add(chunk.data[i], time, chunk.lost if i == 0 else 0)
            found += self.pairs(time - 1)  # inputs come in order of time: of either, all is there that is older
        return found + self.pairs(chunk.until)

    def pairs(self, until: int) -> list[tuple[int, int, Array, Array | None]]:
        """The depth frames with a known partner once all images up to `until` have arrived."""
        found = []
        images, depths = self.images, self.depths
        while depths.count:
            time = int(depths.times[0])
            apart = np.abs(images.times[: images.count] - time)
            if until - self.apart_ns < time and not (apart == 0).any():
                break
            nearest = int(apart.argmin()) if len(apart) else -1
            image = images.frames[nearest].copy() if nearest >= 0 and apart[nearest] <= self.apart_ns else None
            found.append((time, int(depths.lost[0]), depths.frames[0].copy(), image))
            depths.drop(1)
        oldest = (min(until, int(depths.times[0])) if depths.count else until) - self.apart_ns
        images.drop(int((images.times[: images.count] < oldest).sum()))
        return found

    def limit(self, until: int) -> int:
        """What may be promised: no depth frame that still waits is older."""
        return min(until, int(self.depths.times[0]) - 1) if self.depths.count else until
