"""From depthai's messages to chunks: one copy of a frame, its stamp, what is missing before it, and whether it can be true."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kinegraph.devices.clocks.stamps import Losses, chunks
from kinegraph.devices.oak.library import ns
from kinegraph.stream.chunk import Array, Chunk, StreamSpec
from kinegraph.stream.errors import DeviceError

EARLY_NS = 50_000_000
LATE_NS = 30_000_000_000
"""A frame that was taken later than now, or so long ago, bears a wrong time."""


class Message(NamedTuple):
    """One frame's message: its number, its times (ns, of the camera and of this computer), its rows of pixels.

    rows   (height, stride in bytes) uint8, which may vanish when the message does
    """

    number: int
    device: int
    host: int
    width: int
    rows: Array


def message_of(dai: Any, message: Any) -> Message:
    """What is needed of depthai's ImgFrame, nothing copied. Raises DeviceError where it is no depth frame of 16 bits."""
    return _taken(dai, message, ("RAW16",), "depth in mm")


def image_of(dai: Any, message: Any) -> Message:
    """What is needed of an image: grey (GRAY8, RAW8) or colour (RGB888i). Raises DeviceError for any other kind."""
    return _taken(dai, message, ("GRAY8", "RAW8", "RGB888i"), "an image of 8 bits")


def _taken(dai: Any, message: Any, types: tuple[str, ...], wanted: str) -> Message:
    if message.getType().name not in types:
        raise DeviceError(f"expected frames of type {' or '.join(types)} ({wanted}), came {message.getType().name}")
    stride, height = message.getStride(), message.getHeight()
    data = message.getData()
    rows = data[: stride * height].reshape(height, stride) if len(data) >= stride * height else data[:0].reshape(0, 0)
    middle = message.getTimestamp(dai.CameraExposureOffset.MIDDLE)
    return Message(message.getSequenceNum(), ns(message.getTimestampDevice()), ns(middle), message.getWidth(), rows)


class Taken(NamedTuple):
    """A frame as a chunk, and what its event of `timing` says; `problems` are counted."""

    chunk: Chunk | None
    number: int
    device: int
    problems: Sequence[str]


class Frames:
    """A camera's frames, of depth or images, one after the other. Holds the newest frame, to see whether the next one is the same."""

    def __init__(self, spec: StreamSpec, zero_ns: int, latency_ns: int = 0, *, recorded: bool = False) -> None:
        """`zero_ns`: session time of the host clock's zero. Times of what was `recorded` are not compared with their arrival."""
        self._recorded = recorded
        self._shape, self._dtype = spec.shape, spec.dtype
        self._pixel_bytes = spec.sample_bytes // (spec.shape[0] * spec.shape[1])
        self._zero, self._latency = zero_ns, latency_ns
        self._number: int | None = None
        self._stamp = 0
        self._interrupted = False
        self._frame: Array | None = None

    def interrupted(self) -> None:
        """The connection was gone: what is missing before the next frame is not known."""
        self._interrupted = True

    def take(self, message: Message, arrival: int) -> Taken:
        """A frame has arrived now (ns). Raises DeviceError where its size is not the declared one."""
        problems: list[str] = []
        lost = self._lost_before(message.number, problems)
        if lost is None:
            return Taken(None, message.number, message.device, problems)
        frame = self._copy(message)
        if frame is None:
            return Taken(None, message.number, message.device, ["broken frame"])
        self._number, self._interrupted = message.number, False
        self._judge(frame[0], problems)
        stamp = self._stamped(message.host, arrival, problems)
        return Taken(Chunk(np.array([stamp]), frame, stamp, lost), message.number, message.device, problems)

    def _lost_before(self, number: int, problems: list[str]) -> int | None:
        """How many frames are missing; -1: unknown; None: it was there already."""
        last = self._number
        if last is None:
            return 0
        if self._interrupted:
            return -1
        if number == last:
            problems.append("repeated frame")
            return None
        if number < last:
            problems.append("counter reset")
            return -1
        return number - last - 1

    def _copy(self, message: Message) -> Array | None:
        """The one copy; None where the message is shorter than it says."""
        height, width = self._shape[:2]
        rows = message.rows
        if not rows.size or rows.shape[1] < self._pixel_bytes * message.width:
            return None
        if (len(rows), message.width) != (height, width):
            raise DeviceError(
                f"the camera gives frames of {message.width} x {len(rows)}, the graph says {width} x {height}; "
                f"write width: {message.width} and height: {len(rows)}"
            )
        frame = np.empty((1, *self._shape), self._dtype)
        frame.view(np.uint8).reshape(height, -1)[:] = rows[:, : self._pixel_bytes * width]
        return frame

    def _judge(self, frame: Array, problems: list[str]) -> None:
        if not frame.max():
            problems.append("frame without depth" if self._dtype == np.uint16 else "black image")
        elif self._frame is not None and _same(frame, self._frame):
            problems.append("frozen frame")
        self._frame = frame

    def _stamped(self, host: int, arrival: int, problems: list[str]) -> int:
        """Session time at which the frame was taken; never before the last one's."""
        stamp = self._zero + host - self._latency
        if not self._recorded and not arrival - LATE_NS < stamp < arrival + EARLY_NS:
            problems.append("wrong time")
            stamp = arrival - self._latency
        self._stamp = max(stamp, self._stamp + 1)
        return self._stamp


def _same(frame: Array, last: Array) -> bool:
    """Whether two frames are the same bit by bit. Noise tells nearly all apart by one row."""
    middle = len(frame) // 2
    return np.array_equal(frame[middle], last[middle]) and np.array_equal(frame, last)


class ImuPackets:
    """A camera's inertial packets: acceleration and angular velocity, which come together."""

    def __init__(self, rate_hz: float, zero_ns: int, latency_ns: int = 0) -> None:
        self._zero, self._latency = zero_ns, latency_ns
        self._losses = Losses(rate_hz)
        self._stamp = 0
        self._interrupted = False

    def interrupted(self) -> None:
        """The connection was gone: what is missing before the next packet is not known."""
        self._interrupted = True

    def take(self, packets: Sequence[Any], arrival: int) -> list[Chunk]:
        """Chunks of (6,) samples, one more for every gap. What is missing shows as a step of the camera's time."""
        n = len(packets)
        data, time, lost = np.empty((n, 6)), np.empty(n, np.int64), np.zeros(n, np.int64)
        for i, packet in enumerate(packets):
            a, w = packet.acceleroMeter, packet.gyroscope
            data[i] = a.x, a.y, a.z, w.x, w.y, w.z
            stamp = self._zero + ns(a.getTimestamp()) - self._latency
            if not arrival - LATE_NS < stamp < arrival + EARLY_NS:
                stamp = arrival - self._latency
            time[i] = self._stamp = max(stamp, self._stamp + 1)
            device = ns(a.getTimestampDevice())
            lost[i] = self._losses.before(device, None, arrival, restarted=self._interrupted)
            self._interrupted = False
        return list(chunks(time, lost, data))
