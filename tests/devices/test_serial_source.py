"""What every driver of a line of bytes has from `SerialSource`: greeting, silence, stalls, and the word to stop; on a scripted line."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.transport.serial_source import SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import Specs
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed
from tests.support.device_feed import Kept


class Line:
    """Reads are taken from a list; what is written and closed is kept."""

    def __init__(self, reads: list[bytes], feed: Kept) -> None:
        self.reads, self.feed = reads, feed
        self.log: list[str] = []

    def read(self, timeout_s: float) -> bytes:
        if not self.reads and timeout_s:
            self.feed.stop()
        return self.reads.pop(0) if self.reads else b""

    def write(self, data: bytes) -> None:
        self.log.append(data.decode())

    def close(self) -> None:
        self.log.append("closed")

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Bytes:
    """A reading to which every 'x' is a record, and '!' the end of its patience."""

    def __init__(self) -> None:
        self.taken: list[bytes] = []
        self.clock: ClockState | None = None

    def take(self, data: bytes, feed: Feed) -> int:
        self.taken.append(data)
        return data.count(b"x")

    def wrong(self, silent_s: float, came: bytes) -> str:
        return f"came {came!r}" if b"!" in came else ""


@dataclass(frozen=True, slots=True)
class Device(SerialSource):
    port: str
    line: Line
    reading: Bytes
    fails: bool = False

    def __post_init__(self) -> None: ...

    def specs(self) -> Specs:
        return {}

    def connect(self) -> Transport:
        return self.line

    def greet(self, link: Transport, feed: Feed) -> Bytes:
        link.write(b"hello")
        if self.fails:
            raise DeviceError("no answer")
        return self.reading

    def rest(self, link: Transport, feed: Feed) -> None:
        link.write(b"stop")
        raise DeviceError("the cable is out")


def session(reads: list[bytes], *, fails: bool = False) -> tuple[Line, Bytes, str]:
    """The line, what was taken from it, and what was raised."""
    feed = Kept()
    line, reading = Line(reads, feed), Bytes()
    try:
        Device("", line, reading, fails).read(feed)
    except DeviceError as error:
        return line, reading, str(error)
    return line, reading, ""


def test_a_device_is_greeted_read_told_to_stop_and_closed_though_the_cable_is_out() -> None:
    line, reading, raised = session([b"x", b"x"])
    assert reading.taken[:2] == [b"x", b"x"] and not raised
    assert line.log == ["hello", "stop", "closed"]


def test_a_device_that_does_not_answer_is_closed_and_not_told_to_stop() -> None:
    line, reading, raised = session([b"x"], fails=True)
    assert (line.log, reading.taken, raised) == (["hello", "closed"], [], "no answer")


@pytest.mark.parametrize(("reads", "shown"), [([b"x", b"a", b"!"], b"a!"), ([b"b" * 80, b"!"], b"b" * 63 + b"!")])
def test_what_came_since_the_last_record_is_shown(reads: list[bytes], shown: bytes) -> None:
    line, _, raised = session(reads)
    assert raised == f"came {shown!r}" and line.log[-2:] == ["stop", "closed"]


def test_what_piled_up_comes_as_one() -> None:
    _, reading, _ = session([b"x" * 1001, b"y", b"z"])
    assert reading.taken[0] == b"x" * 1001 + b"yz"
