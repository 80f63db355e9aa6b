"""Where a page is served."""

from __future__ import annotations

import socket
from dataclasses import dataclass

from kinegraph.devices.page.access import is_loopback, new_token
from kinegraph.devices.page.serving import tls_context
from kinegraph.stream.errors import KinegraphError

DEFAULT_PORT = 7790
EVERYWHERE = ("0.0.0.0", "::")
"""Not addresses that a browser can open."""


@dataclass(frozen=True, slots=True)
class Address:
    """Where the page is served: on this machine alone unless an address says otherwise; `token` "": to everybody there."""

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    certificate: str = ""
    key: str = ""
    token: str = ""

    def check(self) -> None:
        """Raises KinegraphError for files that are no certificate."""
        try:
            tls_context(self.certificate, self.key)
        except OSError as error:
            raise KinegraphError(f"--page-certificate {self.certificate}: {error.strerror or error}") from None

    def url(self, port: int) -> str:
        """What a person types into a browser."""
        host = _own_address(self.host) if self.host in EVERYWHERE else self.host
        host = f"[{host}]" if ":" in host else host
        start = f"{'https' if self.certificate else 'http'}://{host}:{port}/"
        return f"{start}?token={self.token}" if self.token else start


def _own_address(everywhere: str) -> str:
    """How others reach this machine: its address on the way to the network (nothing is sent), else its name."""
    family, outside = (socket.AF_INET6, "2001:db8::1") if ":" in everywhere else (socket.AF_INET, "192.0.2.1")
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as way:
            way.connect((outside, 9))
            return str(way.getsockname()[0])
    except OSError:
        return socket.gethostname()


def parsed(address: str, certificate: str = "", key: str = "", *, no_token: bool = False) -> Address:
    """HOST, HOST:PORT or :PORT. Raises KinegraphError for anything else, and for one that other machines reach without a token."""
    host, colon, port = address.rpartition(":") if not address.endswith("]") else (address, "", "")
    host = (host if colon else address).strip("[]") or "127.0.0.1"
    if colon and not (port.isdigit() and int(port) < 65536):
        raise KinegraphError(f"--page-at {address}: HOST, HOST:PORT or :PORT, with a port from 0 to 65535")
    if no_token and not is_loopback(host):
        raise KinegraphError(f"--no-token is for this machine alone; {host} can be reached from others")
    return Address(host, int(port) if colon else DEFAULT_PORT, certificate, key, "" if no_token else new_token())
