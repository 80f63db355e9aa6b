"""Commands to an Xbus device and their answers, among measurements that may still be coming."""

from __future__ import annotations

import time

from kinegraph.devices.mti import xbus
from kinegraph.devices.mti.xbus import XbusDecoder, XbusRun
from kinegraph.devices.transport.handshake import shown
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed

ANSWER_S, TRIES = 1.0, 3


class XbusCommands:
    """Commands and their answers, while measurements may still be coming."""

    def __init__(self, link: Transport, feed: Feed, port: str) -> None:
        self.decoder = XbusDecoder()
        self.behind: list[XbusRun] = []
        """What came in one read with the last answer, behind it."""
        self._link, self._feed, self._port = link, feed, port

    def ask(self, mid: int, data: bytes = b"") -> bytes:
        """Send a message; returns the data of its answer (the next higher identifier). Raises DeviceError."""
        came = b""
        for _ in range(TRIES):
            self._link.write(xbus.message(mid, data))
            deadline = time.monotonic() + ANSWER_S
            while (rest := deadline - time.monotonic()) > 0:
                if self._feed.stopped:
                    raise DeviceError("stopped while waiting for an answer")
                piece = self._link.read(min(rest, 0.1))
                came = (came + piece)[:64]
                came_runs = self.decoder.feed(piece).runs
                for i, run in enumerate(came_runs):
                    if run.mid == mid + 1:
                        self.behind = came_runs[i + 1 :]
                        return run.data
                    if run.mid == xbus.ERROR and mid != xbus.GO_TO_CONFIG:
                        raise DeviceError(f"{self._port} refused message {mid:02X}: {reason(run)}")
        raise DeviceError(
            f"no answer from {self._port} within {TRIES * ANSWER_S:g} s: expected FA FF {mid + 1:02X} after message {mid:02X} "
            f"(is it an MTi, in Xbus mode, and `baud` as set in it?); came {shown(came)}"
        )


def reason(run: XbusRun) -> str:
    """What an error message says."""
    code = run.data[0] if run.data else -1
    return xbus.ERRORS.get(code, f"error {code:#x}")
