"""Where a page is served."""

from __future__ import annotations

from dataclasses import dataclass

from devices.outlets.page.access import is_loopback, new_token
from devices.outlets.page.serving import tls_context
from stream.errors import KinegraphError

DEFAULT_PORT = 7790


@dataclass(frozen=True, slots=True)
class Address:
    """Where the page is served: on this machine alone unless told otherwise, and then with a token."""

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
        host = f"[{self.host}]" if ":" in self.host else self.host
        start = f"{'https' if self.certificate else 'http'}://{host}:{port}/"
        return f"{start}?token={self.token}" if self.token else start


def parsed(address: str, certificate: str = "", key: str = "") -> Address:
    """HOST, HOST:PORT or :PORT. Raises KinegraphError for what is none of these."""
    host, colon, port = address.rpartition(":") if not address.endswith("]") else (address, "", "")
    host = (host if colon else address).strip("[]") or "127.0.0.1"
    if colon and not (port.isdigit() and int(port) < 65536):
        raise KinegraphError(f"--page-at {address}: HOST, HOST:PORT or :PORT, with a port from 0 to 65535")
    token = "" if is_loopback(host) else new_token()
    return Address(host, int(port) if colon else DEFAULT_PORT, certificate, key, token)
