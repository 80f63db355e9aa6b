"""A camera for tests of graphs, named in YAML as `camera_part.Camera`: frame number k shows k + 1 everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

START = 1_700_000_000 * NS


@dataclass(frozen=True, slots=True)
class Camera(Source):
    """Frames of 48 x 64; every seventh chunk after the first says that two were lost."""

    rate_hz: float = param(200.0)
    frames: int = param(300)
    realtime: bool = param(False)
    outputs: ClassVar[tuple[str, ...]] = ("depth",)

    @property
    def live(self) -> bool:
        return self.realtime

    def specs(self) -> Specs:
        return {"depth": StreamSpec((48, 64), np.dtype(np.uint16), self.rate_hz, units=("mm",))}

    def read(self, feed: Feed) -> None:
        anchor = feed.now() if self.realtime else START
        for k in range(self.frames):
            time = anchor + round(k * NS / self.rate_hz)
            if self.realtime and feed.wait(max(0.0, (time - feed.now()) / NS)):
                return
            frame = np.full((1, 48, 64), k % 60_000 + 1, np.uint16)
            feed.emit(Chunk(np.array([time]), frame, time, 2 if k % 7 == 6 else 0), "depth")
