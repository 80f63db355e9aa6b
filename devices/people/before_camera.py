"""A depth camera of no maker with someone before it, rendered: a source of its own, as fast as the graph takes it if that is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer, camera_of
from kinegraph.devices.simulation.paced import PacedSource
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.domain.axes import CAMERA
from kinegraph.stream.domain.intrinsics import lens
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed


@dataclass(frozen=True, slots=True)
class BeforeCamera(PacedSource):
    """Someone who stands, walks on the spot and moves the arms before a depth camera, after two seconds of an empty room.

    depth   (height, width) uint16 mm, 0: no measurement
    mono    (height, width) uint8, the same pixels
    joints  (13, 3) m: where the joints are; x right, y down, z away from the camera

    Frame i is the same whenever and in whatever chunks it is made.
    """

    outputs: ClassVar[tuple[str, ...]] = ("depth", "mono", "joints")

    width: int = param(320, least=64, most=1280, help="pixels in a row")
    height: int = param(200, least=48, most=1024, help="rows")
    fps: float = param(30.0, above=1.0, most=120.0, help="frames per second")
    seed: int = param(0, least=0, help="another seed, other noise")

    @property
    def chunk_s(self) -> float:
        return 1 / self.fps

    def specs(self) -> Specs:
        camera = lens(camera_of(self.width, self.height), self.width, self.height, 1.0)
        meta = {"simulated": True, "camera": camera}
        shape = (self.height, self.width)
        return {
            "depth": StreamSpec(shape, np.dtype(np.uint16), rate_hz=self.fps, units=("mm",), meta=meta),
            "mono": StreamSpec(shape, np.dtype(np.uint8), rate_hz=self.fps, meta=meta),
            "joints": StreamSpec(
                (len(POINTS), 3), rate_hz=self.fps, channels=POINTS, units=("m",), meta=meta | {"axes": CAMERA.facts()}
            ),
        }

    def prepare(self) -> None:
        RenderedPerformer(64, 48).frame(0, 5.0)  # what it is drawn with is compiled before the session begins

    def read(self, feed: Feed) -> None:
        performer = RenderedPerformer(self.width, self.height, seed=self.seed)
        drawn = self._drawn(performer, 0)
        for frame, stamp in self.frames(feed, self.fps):
            for output, data in drawn.items():
                feed.emit(Chunk(np.array([stamp]), data[None], stamp), output)
            if self.realtime and feed.wait(max(0.0, stamp / NS + 0.5 / self.fps - feed.now() / NS)):
                return
            drawn = self._drawn(
                performer, frame + 1
            )  # before it is due, while no reader waits: a camera takes no time to draw

    def _drawn(self, performer: RenderedPerformer, frame: int) -> dict[str, Array]:
        """A frame by output, what others wait for first."""
        seconds = frame / self.fps
        return {
            "mono": performer.image(frame, seconds),
            "depth": performer.frame(frame, seconds),
            "joints": performer.joints(seconds),
        }
