"""depthai's own recordings as a source: what its RecordMessage wrote, also what a killed process left of it. depthai is not needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import structlog
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.oak.adapter import Frames, Message
from kinegraph.devices.recorded.depthai_frames import RAW16, SCHEMA, RecordedMessage, decode
from kinegraph.stream.chunk import NS, Specs, StreamSpec
from kinegraph.stream.errors import DeviceError, RecordingError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.recording.read.records import RecordFile, declared, messages
from kinegraph.stream.source import Feed, Source

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class DepthaiReplay(Source):
    """Depth frames from an MCAP file that depthai 3 recorded (RecordMessage, type RAW16).

    depth    (height, width) uint16 in mm, 0: no measurement
    timing   an event per frame: its number, the camera's time, arrival, stamp

    The first frame is stamped when it is read, the others as much later as they were recorded later; missing frames are known from their
    numbers. A file without its end is read as far as it is whole.
    """

    outputs: ClassVar[tuple[str, ...]] = ("depth", "timing")

    path: str = param(help="the file, FILE.mcap")
    width: int = param(640, least=1, most=4096, help="pixels in a row of a frame")
    height: int = param(400, least=1, most=4096, help="rows of a frame")
    fps: float = param(30.0, above=0, most=240, help="frames per second")
    topic: str = param("", help="which frames, where the file holds several kinds; left out: the first")
    speed: float = param(
        1.0, least=0, help="how many times as fast as it was recorded; 0: as fast as the graph takes it"
    )

    @property
    def live(self) -> bool:
        return False

    @property
    def chunk_s(self) -> float:
        return 1 / self.fps

    def specs(self) -> Specs:
        meta = {"device": "OAK", "invalid": 0}
        shape = (self.height, self.width)
        depth = StreamSpec(shape, np.dtype(np.uint16), rate_hz=self.fps, units=("mm",), meta=meta)
        return {"depth": depth, "timing": timing_spec()}

    def read(self, feed: Feed) -> None:
        frames, first = None, 0
        for recorded in self._recorded(feed):
            if frames is None:
                first = recorded.host
                began = feed.now()
                frames = Frames(self.specs()["depth"], began - first, recorded=True)
            ahead_s = (recorded.host - first) / NS
            if self.speed and feed.wait(max(0.0, ahead_s / self.speed - (feed.now() - began) / NS)):
                return
            if feed.stopped:
                return
            self._emit(frames, recorded, feed)
        if frames is None:
            raise DeviceError(f"{self.path}: holds no whole depth frame")

    def _emit(self, frames: Frames, recorded: RecordedMessage, feed: Feed) -> None:
        arrival = feed.now()
        message = Message(recorded.number, recorded.device, recorded.host, recorded.width, recorded.rows)
        taken = frames.take(message, arrival)
        for problem in taken.problems:
            feed.problem(problem)
        if taken.chunk is None:
            return
        if taken.chunk.lost > 0:
            feed.problem("lost frame", taken.chunk.lost)
        feed.emit(taken.chunk, "depth")
        feed.emit(timing_chunk(taken.number, taken.device, arrival, taken.chunk.time, taken.chunk.lost), "timing")

    def _recorded(self, feed: Feed) -> Iterator[RecordedMessage]:
        """The frames of the file, one after the other; a damaged place in it is passed over and counted."""
        try:
            file = RecordFile(Path(self.path))
        except RecordingError as error:
            raise DeviceError(str(error)) from None
        try:
            if not file.finished:
                log.warning("the recording was cut off; its complete part is read", path=self.path)
            wanted: set[int] = set()
            topics: dict[int, str] = {}
            for body, channel in _bodies(file, topics, feed):
                if not wanted and topics.keys():
                    wanted = self._wanted(topics)
                if channel in wanted:
                    yield from self._frame(body, feed)
        finally:
            file.close()

    def _wanted(self, topics: dict[int, str]) -> set[int]:
        """The channels to be read, of those with frames."""
        if self.topic:
            if self.topic not in topics.values():
                raise DeviceError(
                    f"{self.path}: has no frames on {self.topic!r}; {nearest(self.topic, topics.values())}"
                )
            return {number for number, topic in topics.items() if topic == self.topic}
        return {next(iter(topics))}

    def _frame(self, body: memoryview, feed: Feed) -> Iterator[RecordedMessage]:
        recorded = decode(body)
        if recorded is None:
            feed.problem("broken frame")
        elif recorded.type != RAW16:
            raise DeviceError(
                f"{self.path}: holds frames of type {recorded.type}, not RAW16 ({RAW16}): depth has to be recorded by RecordMessage"
            )
        else:
            yield recorded


def _bodies(file: RecordFile, topics: dict[int, str], feed: Feed) -> Iterator[tuple[memoryview, int]]:
    """(body, channel) of every message; `topics` receives the channels with frames as they are declared."""
    schemas: dict[int, str] = {}
    for record in file.records:
        if record.opcode != Opcode.CHUNK:
            continue
        try:
            data = file.unpack(record)
        except RecordingError as error:
            log.warning("a part of the recording cannot be read", error=str(error))
            feed.problem("damaged part")
            continue
        for item in declared(data):
            if isinstance(item, Schema):
                schemas[item.id] = item.name
            elif isinstance(item, Channel) and schemas.get(item.schema_id) == SCHEMA:
                topics[item.id] = item.topic
        for message in messages(data):
            yield message.body, message.channel
