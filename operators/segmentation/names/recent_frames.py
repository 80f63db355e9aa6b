"""The newest frames of a stream by their stamps, and what a repetition of them measures: how far it goes, how alike its sides are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.segmentation.names.comparison import unlike
from kinegraph.stream.chunk import NEVER, Chunk, Samples, Times


@dataclass(slots=True)
class RecentFrames:
    """frames (ring, features) and stamps (ring,): the newest, by number modulo ring; seen (1,): how many have come."""

    frames: Samples
    stamps: Times
    seen: Times

    @classmethod
    def of(cls, ring: int, width: int) -> RecentFrames:
        return cls(np.full((ring, width), np.nan), np.full(ring, NEVER), np.zeros(1, np.int64))

    def add(self, chunk: Chunk) -> None:
        n = len(self.stamps)
        places = (self.seen[0] + np.arange(len(chunk))) % n
        self.frames[places[-n:]], self.stamps[places[-n:]] = chunk.data[-n:], chunk.time[-n:]
        self.seen[0] += len(chunk)

    def span(self, onset: int, end: int) -> Samples:
        """The frames (n, features) from a stamp to another; empty if the first of them has left the ring."""
        newest = int(self.seen[0])
        order = np.arange(max(0, newest - len(self.stamps)), newest) % len(self.stamps)
        stamps = self.stamps[order]
        first, last = np.searchsorted(stamps, [onset, end + 1])
        if first == last or stamps[first] != onset:
            return self.frames[:0]
        return self.frames[order[first:last]]

    def travelled(self, onset: int, end: int) -> float:
        """How far the last frame between these stamps lies from the first; NaN where fewer than two are known."""
        within = np.flatnonzero((self.stamps >= onset) & (self.stamps <= end) & np.isfinite(self.frames).all(1))
        if len(within) < 2:
            return np.nan
        order = within[np.argsort(self.stamps[within])]
        return float(np.linalg.norm(self.frames[order[-1]] - self.frames[order[0]]))


def widest(x: Samples) -> tuple[float, int]:
    """How far the feature of x (n, features) goes that moves most, and which one it is; NaN and -1 where nothing is known."""
    known = np.isfinite(x).any(0) if len(x) else np.zeros(0, bool)
    if not known.any():
        return np.nan, -1
    high, low = np.where(np.isfinite(x), x, -np.inf).max(0), np.where(np.isfinite(x), x, np.inf).min(0)
    ranges = np.where(known, high - low, -1.0)
    most = int(ranges.argmax())
    return float(ranges[most]), most


def sides_alike(x: Samples, image: Samples) -> float:
    """How alike both sides move, at once or in turn, in a repetition x (n, features) with this mirror image: 1, the same; 0, not at all.

    One less the distance to the mirror image, at the phase at which that is least, as a share of how far two frames of the repetition lie
    apart on the mean (root of the mean square). NaN where either is not known.
    """
    if len(x) < 2 or len(image) != len(x):
        return np.nan
    known = np.isfinite(x).all(1) & np.isfinite(image).all(1)
    if 2 * known.sum() < len(x):
        return np.nan
    size = float(np.sqrt(2.0 * x[known].var(0).mean()))
    far = unlike(x, image, np.empty((len(x), len(x))), np.empty((2, len(x))))
    return max(0.0, 1.0 - far / size) if size > 0.0 and np.isfinite(far) else np.nan
