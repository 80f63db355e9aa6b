"""Who may look at the page: addresses, the token, where a web page that asks comes from, and what browsers must refuse."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from ipaddress import ip_address
from urllib.parse import parse_qs, urlsplit

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
COOKIE = "kinegraph"
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine reach `host`."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    return secrets.token_urlsafe(24)


@dataclass(frozen=True, slots=True)
class Access:
    """token    what a client must show; "": no token, on loopback only
    port        where the server listens
    encrypted   whether browsers must never send the cookie in the clear
    here        whether only this machine reaches it
    """

    token: str
    port: int
    encrypted: bool = False
    here: bool = True

    def host_is_ours(self, host: str) -> bool:
        """Whether a request names us. On loopback a name that merely leads here is refused: it may be a web site's (DNS rebinding)."""
        return not self.here or host in {f"{name}:{self.port}" for name in LOOPBACK_NAMES}

    def origin_is_ours(self, origin: str | None, host: str) -> bool:
        """Whether the web page that opens a connection is our own; programs that are no browsers send no origin."""
        return origin is None or (urlsplit(origin).netloc == host and urlsplit(origin).scheme in ("http", "https"))

    def knows_token(self, path: str, cookies: str) -> bool:
        """Whether a request shows the token: in its address, or in the cookie that the page set."""
        if not self.token:
            return True
        shown = parse_qs(urlsplit(path).query).get("token", [])
        try:
            jar = SimpleCookie(cookies)
        except CookieError:
            jar = SimpleCookie()
        if self._name in jar:
            shown.append(jar[self._name].value)
        return any(hmac.compare_digest(given.encode(), self.token.encode()) for given in shown)

    @property
    def _name(self) -> str:
        """Browsers send cookies to every port, so each page has one of its own."""
        return f"{COOKIE}-{self.port}"

    @property
    def cookie(self) -> str:
        """Lax, not strict: an address that was clicked on in another page leads here by way of a redirection."""
        return f"{self._name}={self.token}; HttpOnly; SameSite=Lax; Path=/{'; Secure' if self.encrypted else ''}"
