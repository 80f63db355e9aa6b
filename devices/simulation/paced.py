"""Simulated sources that go by in frames: for how long, at what pace, and each frame when it is due."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

from kinegraph.stream.chunk import NS
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source


@dataclass(frozen=True, slots=True, kw_only=True)
class PacedSource(Source):
    """A source that goes at the clock's pace, or as fast as the graph takes it."""

    duration_s: float = param(0.0, least=0.0, help="how long; 0: until stopped")
    realtime: bool = param(True, help="false: as fast as the graph takes it")

    @property
    def live(self) -> bool:
        return self.realtime

    def frames(self, feed: Feed, rate_hz: float) -> Iterator[tuple[int, int]]:
        """(frame, stamp) in time, until the feed stops."""
        begun, last = feed.now(), round(self.duration_s * rate_hz)
        for frame in range(last) if last else count():
            stamp = begun + round(frame * NS / rate_hz)
            if self.realtime and feed.wait(max(0, stamp - feed.now()) / NS):
                return
            if feed.stopped:
                return
            yield frame, stamp


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSource(PacedSource):
    """One that makes frames one by one, each a chunk."""

    rate_hz: float = param(30.0, above=1.0, most=240.0, help="frames per second")

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz
