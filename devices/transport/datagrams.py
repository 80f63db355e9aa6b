"""Datagrams that come to this computer by UDP, behind the interface of a serial port: each read gives one."""

from __future__ import annotations

import errno
import select
import socket
import time
from collections.abc import Iterable
from contextlib import suppress

from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.stream.errors import DeviceError

MAX = 65536
BUFFER = 1 << 20
"""Bytes that the system is asked to buffer."""
GATHER_S = 0.025
GATHER_HELP = (
    "datagrams of this time are read at once, for half the work; 0: each as it comes, for live steering; left out: 25 ms where every "
    "stream comes 80 times a second or more and its stamps follow a counter or the sender's time, else 0"
)


def gathered_s(rates_hz: Iterable[float | None]) -> float:
    """The default time to gather datagrams: 0 where few would gather; `rates_hz` of streams that have a clock."""
    return GATHER_S if all(hz and hz * GATHER_S >= 2 for hz in rates_hz) else 0.0


class UdpTransport(ClosesAtExit):
    """Listens at "udp://host:port": 127.0.0.1 hears this computer alone, 0.0.0.0 everybody.

    gather_s   how long datagrams are left to gather before they are read, one after the other: fewer rests, after which all is cold
    """

    def __init__(self, address: str, gather_s: float = 0.0) -> None:
        self.address, self._gather_s = address, gather_s
        host, _, port = address.removeprefix("udp://").rpartition(":")
        if not host or not port.isdigit() or int(port) > 65535:
            raise DeviceError(
                f"{address!r} is not an address to listen at; write udp://127.0.0.1:PORT, or udp://0.0.0.0:PORT"
            )
        host = host.strip("[]")
        self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, int(port)))
        except OSError as error:
            self._socket.close()
            why = (
                "another program listens there; close that one first"
                if error.errno == errno.EADDRINUSE
                else error.strerror or error
            )
            raise DeviceError(f"{address} cannot be bound: {why}") from None
        with suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> bytes:
        """One datagram; b"": nothing came in this time."""
        try:
            if self._gather_s:
                try:
                    return self._socket.recv(MAX)
                except BlockingIOError:
                    time.sleep(self._gather_s)
            if timeout_s and not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            return self._socket.recv(MAX)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise DeviceError(f"{self.address} is gone: {error}") from None

    def write(self, data: bytes) -> None:
        raise DeviceError(f"{self.address}: nothing can be sent to a device that only sends datagrams")

    def close(self) -> None:
        with suppress(OSError):
            self._socket.close()
