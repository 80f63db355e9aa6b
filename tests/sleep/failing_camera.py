"""A depth camera over a simulated bedroom that fails, as real ones do: a source for tests of whole sessions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from kinegraph.devices.oak.adapter import Frames, Message
from kinegraph.devices.people.bedroom import Bedroom
from kinegraph.devices.people.bedside import Bedside
from kinegraph.stream.chunk import NS, Array, Specs, empty
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed, Source

BEGUN = 1_772_395_200 * NS
"""2026-03-01T20:00:00Z."""


@dataclass(frozen=True, slots=True)
class FailingCamera(Source):
    """The frames of `room` as a camera's messages, through the adapter that real cameras use, as fast as the graph takes them.

    failures  (from s, to s, what): in this time it is "unplugged", or gives frames of another "size"; both end the reading, and when it is
              opened again, that time is over
    next      number of the frame that comes next: it lives over openings, as the camera's clock does
    """

    outputs: ClassVar[tuple[str, ...]] = ("depth", "truth")

    room: Bedside = field(default_factory=Bedside)
    failures: tuple[tuple[float, float, Literal["unplugged", "size"]], ...] = ()
    next: list[int] = field(default_factory=lambda: [0])

    @property
    def live(self) -> bool:
        return False

    def specs(self) -> Specs:
        return self.room.specs()

    def read(self, feed: Feed) -> None:
        room, specs = self.room, self.specs()
        scene = Bedroom(room.width, room.height, room.plans(), seed=room.seed)
        frames = Frames(specs["depth"], BEGUN, recorded=True)
        feed.ready()
        while self.next[0] < room.plans()[0].length_s * room.fps and not feed.stopped:
            number = self.next[0]
            seconds = number / room.fps
            frame = scene.frame(number, seconds)
            for begin, end, what in self.failures:
                if begin <= seconds < end:
                    self.next[0] = round(end * room.fps)
                    if what == "unplugged":
                        raise DeviceError("the camera is gone")
                    frame = frame[:-8]  # and the adapter raises
            stamp = round(seconds * NS)
            taken = frames.take(Message(number, stamp, stamp, room.width, rows_of(frame)), BEGUN + stamp)
            assert taken.chunk
            feed.emit(taken.chunk, "depth")
            feed.emit(empty(specs["truth"], BEGUN + stamp), "truth")
            self.next[0] = max(number + 1, self.next[0])


def rows_of(frame: Array) -> Array:
    """A frame's pixels as the bytes of a message."""
    return np.ascontiguousarray(frame).view(np.uint8).reshape(len(frame), -1)
