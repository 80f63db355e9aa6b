"""A device at the end of a line of bytes: opened, greeted, read until the session ends, stopped. What all such drivers share."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Protocol

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.transport.handshake import all_there
from kinegraph.devices.transport.transport import Transport, connect, missing, present
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed, Source

READ_S = 0.1
STALL_S = 0.1
"""After a longer pause, everything that piled up is taken as one read, so that its arrival is that of its newest byte."""
MUCH = 1000
"""A read of more bytes may have left some behind."""
SHOWN = 64
"""Bytes that are kept to show what came instead of a sample."""


class Reading(Protocol):
    """Bytes to chunks: a decoder, a clock, and whatever else a driver remembers between two reads."""

    @property
    def clock(self) -> ClockState | None:
        """What is known of the device's clock; None: it has none."""

    def take(self, data: bytes, feed: Feed) -> int:
        """Emit what a read has brought (b"": nothing came in time); returns how many good records were in it."""

    def wrong(self, silent_s: float, came: bytes) -> str:
        """What is wrong if there has been no good record for so long, in which `came` was the last to come; "": nothing."""


class SerialSource(Source):
    """A source that reads bytes from `port`. A driver says how to `greet` its device, and gives the `Reading` that takes its bytes."""

    __slots__ = ()
    port: str

    @property
    def gathered_s(self) -> float:
        """How long bytes are left to gather after a read that brought good records: fewer reads, each of which finds everything cold."""
        return 0.0

    def connect(self) -> Transport:
        """Open the port; raises DeviceError."""
        return connect(self.port, getattr(self, "baud", 115200))

    def greet(self, link: Transport, feed: Feed) -> Reading:
        """Bring the device to send what is wanted; raises DeviceError if it is not there, or is another one."""
        raise NotImplementedError

    def rest(self, link: Transport, feed: Feed) -> None:
        """Tell the device to stop. Whether it hears that does not matter."""

    def prepare(self) -> None:
        line_below.prepare()

    def present(self) -> bool | None:
        return present(self.port)

    @property
    def may_appear(self) -> bool:
        return self.port.startswith("ble://")

    def missing(self) -> str:
        return missing(self.port)

    def fetch(self, link: Transport, heard: float) -> bytes:
        """What has come; `heard`: when the last good record came (monotonic, s)."""
        data = link.read(READ_S)
        stalled = time.monotonic() - heard > STALL_S
        return all_there(link, data) if data and (stalled or len(data) > MUCH) else data

    def read(self, feed: Feed) -> None:
        with self.connect() as link:
            reading = self.greet(link, feed)
            try:
                self._pass_on(link, reading, feed)
            finally:
                with suppress(DeviceError):
                    self.rest(link, feed)

    def _pass_on(self, link: Transport, reading: Reading, feed: Feed) -> None:
        with ClockLog(self.port, feed, lambda: reading.clock) as clock_log:
            self._take_all(link, reading, feed, clock_log)

    def _take_all(self, link: Transport, reading: Reading, feed: Feed, clock_log: ClockLog) -> None:
        heard, came, pause_s = time.monotonic(), b"", self.gathered_s
        while not feed.stopped:
            data = self.fetch(link, heard)
            now = time.monotonic()
            if reading.take(data, feed):
                heard, came = now, b""
                if pause_s:
                    feed.wait(pause_s)
            else:
                came = (came + data)[-SHOWN:]
            if wrong := reading.wrong(now - heard, came):
                raise DeviceError(wrong)
            clock_log.tell()
