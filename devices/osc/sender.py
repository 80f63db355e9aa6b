"""Datagrams to one receiver, each sent at once or not at all."""

from __future__ import annotations

import socket
from collections.abc import Iterable

import structlog

from kinegraph.stream.errors import DeviceError

log = structlog.get_logger(__name__)


BACK_AFTER = 10
"""A receiver is back after this number of sendings in a row without an error: of a closed port only every other datagram tells."""


class OscSender:
    """A UDP socket. A receiver that is not there, or a full network, holds nothing up: that is logged once, until it is back."""

    def __init__(self, what: str, host: str, port: int) -> None:
        """Raises DeviceError for a host that is not known."""
        self._what, self._where = what, f"{host}:{port}"
        self._silent = 0
        try:
            address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(address[0], socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.connect(address[4])
        except OSError as error:
            raise DeviceError(f"{what} cannot be sent to {host}:{port}: {error}") from None

    def send(self, datagrams: Iterable[bytes]) -> None:
        try:
            for datagram in datagrams:
                self._socket.send(datagram)
            self._silent = max(0, self._silent - 1)
        except OSError as error:
            if not self._silent:
                log.warning(f"no receiver for {self._what}", receiver=self._where, error=str(error))
            self._silent = BACK_AFTER

    def close(self) -> None:
        self._socket.close()
