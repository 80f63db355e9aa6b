"""Commands to a Shimmer and their answers, while it does not measure."""

from __future__ import annotations

import time

from kinegraph.devices.shimmer import protocol as protocol
from kinegraph.devices.transport.handshake import quiet, shown
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed

ANSWER_S, TRIES = 2.0, 3


class ShimmerCommands:
    """Commands and their answers, while the device does not measure."""

    def __init__(self, link: Transport, feed: Feed, port: str) -> None:
        self._link, self._feed, self._port = link, feed, port

    def rest(self) -> None:
        """Stop it, if it measures still."""
        self._link.write(bytes([protocol.STOP]))
        quiet(self._link, self._feed, 0.2, 2.0)

    def ask(self, command: bytes, code: int, size: int) -> bytes:
        """Send a command; returns its answer (see `protocol.answer_in`). Raises DeviceError."""
        came = b""
        for _ in range(TRIES):
            self._link.write(command)
            came, deadline = b"", time.monotonic() + ANSWER_S
            while (rest := deadline - time.monotonic()) > 0:
                if self._feed.stopped:
                    raise DeviceError("stopped while waiting for an answer")
                came += self._link.read(min(rest, 0.1))
                if (found := protocol.answer_in(came, code, size)) is not None:
                    return found
        raise DeviceError(
            f"no answer from {self._port} within {TRIES * ANSWER_S:g} s: expected {code:02X} after command {command[0]:02X} "
            f"(is it a Shimmer3 with LogAndStream, on, and not docked?); came {shown(came)}"
        )
