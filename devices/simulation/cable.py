"""The device's end of the cable: a pseudo-terminal, which the host opens like a serial port, or a TCP server."""

from __future__ import annotations

import os
import select
import shutil
import socket
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from kinegraph.stream.errors import DeviceError

MAX = 65536
MAX_WAITING = 1 << 20
"""Bytes that wait for a slow host."""


class Line(Protocol):
    """One end of a cable.

    address   what the host opens; it stays the same when the cable is pulled out and put in again
    """

    address: str

    def read(self, timeout_s: float) -> bytes:
        """What the host has sent, or b"" if nothing comes in time."""

    def write(self, data: bytes) -> None:
        """Send without waiting: what the host does not fetch is lost, as on a serial line."""

    def unplug(self) -> None:
        """Pull the cable out."""

    def plug(self) -> None:
        """Put it in again."""

    def close(self) -> None:
        """Pull it out for good."""


class PseudoTerminal:
    """A pseudo-terminal behind a name of its own, that accepts every baud rate at full speed.

    The host's side is held open here as well, and raw from the beginning: software that sets nothing itself is not sent its own
    bytes back, and the settings last when the host closes.

    patient   once the host has sent something, what it does not fetch in time waits instead of being lost: the kernel holds only 4 kB,
              half a second of a fast device, and a busy computer is no fault that the user of a simulated device asked for
    """

    def __init__(self, name: str = "ttySIM", patient: bool = False) -> None:
        self._patient, self._asked, self._waiting = patient, False, b""
        self._folder = Path(tempfile.mkdtemp(prefix="kinegraph-"))
        self._link = self._folder / name
        self.address = str(self._link)
        self._master = self._host = -1
        self.plug()

    def plug(self) -> None:
        if self._master >= 0:
            return
        import pty
        import tty

        self._master, self._host = pty.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._master, False)
        self._link.symlink_to(os.ttyname(self._host))

    def unplug(self) -> None:
        if self._master < 0:
            return
        self._link.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._host)
        self._master = self._host = -1
        self._asked, self._waiting = False, b""

    def read(self, timeout_s: float) -> bytes:
        waiting = [self._master] if self._master >= 0 else []
        if not select.select(waiting, [], [], timeout_s)[0]:
            return b""
        try:
            heard = os.read(self._master, MAX)
        except OSError:
            return b""
        self._asked = self._asked or bool(heard)
        return heard

    def write(self, data: bytes) -> None:
        if self._master < 0:
            return
        data, sent = self._waiting + data, 0
        with suppress(OSError):
            sent = os.write(self._master, data)
        self._waiting = data[sent:][:MAX_WAITING] if self._patient and self._asked else b""

    def close(self) -> None:
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)


class TcpLine:
    """A TCP server for one host at a time; a new one takes the place of the old. Port 0 takes any that is free."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._host, self._port = host, port
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None
        self.plug()
        self.address = f"tcp://{host}:{self._port}"

    def plug(self) -> None:
        if self._server is not None:
            return
        try:
            self._server = socket.create_server((self._host, self._port))
        except OSError as error:
            raise DeviceError(f"tcp://{self._host}:{self._port} cannot be served: {error.strerror or error}") from None
        self._port = self._server.getsockname()[1]

    def unplug(self) -> None:
        self._hang_up()
        if self._server is not None:
            self._server.close()
            self._server = None

    def read(self, timeout_s: float) -> bytes:
        waiting = [s for s in (self._server, self._client) if s is not None]
        for ready in select.select(waiting, [], [], timeout_s)[0]:
            if ready is self._server:
                self._accept()
            else:
                return self._receive(ready)
        return b""

    def write(self, data: bytes) -> None:
        if self._client is not None:
            try:
                self._client.send(data)
            except BlockingIOError:
                pass
            except OSError:
                self._hang_up()

    def close(self) -> None:
        self.unplug()

    def _accept(self) -> None:
        assert self._server is not None
        with suppress(OSError):
            client, _ = self._server.accept()
            self._hang_up()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client

    def _receive(self, client: socket.socket) -> bytes:
        try:
            data = client.recv(MAX)
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None


def line_at(address: str = "", name: str = "ttySIM", patient: bool = False) -> Line:
    """A pseudo-terminal (`patient`: see there), where the system has such, or, for "tcp://host:port" and elsewhere, a TCP server."""
    if not address:
        return PseudoTerminal(name, patient) if _has_pseudo_terminals() else TcpLine()
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    if not address.startswith("tcp://") or not host or not port.isdigit():
        raise DeviceError(
            f"{address!r} is not an address to serve; write tcp://host:port, or nothing for a pseudo-terminal"
        )
    return TcpLine(host.strip("[]"), int(port))


def _has_pseudo_terminals() -> bool:
    """Windows has no pseudo-terminals."""
    try:
        import pty  # noqa: F401
        import tty  # noqa: F401
    except ImportError:
        return False
    return True
