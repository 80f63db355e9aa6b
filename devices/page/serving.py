"""The page's server on its port: the page's own files, `/metrics`, and one WebSocket per client."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import socket
import ssl
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol

import structlog
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from kinegraph.devices.page.access import HEADERS, Access, is_loopback
from kinegraph.devices.page.hub import Looking
from kinegraph.devices.page.transfer.wire import MAX_ASKED_BYTES, asked, encode
from kinegraph.stream.errors import KinegraphError

log = structlog.get_logger(__name__)

FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
AVATAR = "/avatar.vrm"
"""The one avatar that this page shows; what a client asks for never names a file."""
SOCKET = "/socket"
MODULES = "/panels/"
REPORTS = "/reports/"
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:; sandbox"
"""A report holds all that it shows, and runs nothing."""
NO_PAGE = HTTPStatus.NOT_FOUND, "there is no such page\n"
MAX_CLIENTS = 64
WAITING_BYTES = 1 << 18
"""More than this is not buffered for a client that does not read, here or by the system: it is sent no news until it has caught up."""
METRICS_TYPE = "application/openmetrics-text; version=1.0.0; charset=utf-8"


class Shows(Protocol):
    """What clients are shown: a session, or a recording."""

    clients: set[Looking]

    @property
    def modules(self) -> Mapping[str, str]:
        """Panels that are not the page's own: their JavaScript, by kind."""

    def visitor(self) -> Looking: ...
    def greeting(self) -> bytes: ...
    def take(self, client: Looking, asked: Any) -> None: ...
    def news_for(self, client: Looking) -> list[bytes]: ...
    def want(self) -> None: ...


def built(name: str) -> bytes:
    """A file of the page as it was built. Raises FileNotFoundError."""
    return (files("kinegraph.devices.page") / "built" / name).read_bytes()


class PageServer:
    """Serves what `shows` says to whoever has access.

    metrics      writes the text behind `/metrics`
    files        the page's own files, by path: (name, type)
    avatar       what stands behind AVATAR: a VRM file
    reports      the session's reports, HTML files, once they are written; clients name them by their number
    understand   what a client asks for, out of its message; raises ValueError
    """

    def __init__(
        self,
        shows: Shows,
        metrics: Callable[[], str],
        *,
        files: Mapping[str, tuple[str, str]] = FILES,
        understand: Callable[[str | bytes], Any] = asked,
        avatar: bytes = b"",
        reports: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        self._reports = reports
        self._shows, self._metrics, self._files, self._understand = shows, metrics, files, understand
        self._access, self._avatar = Access("", 0), avatar
        self._packed = {path: gzip.compress(built(name), mtime=0) for path, (name, _) in files.items()}
        self._server: Server | None = None

    async def open(self, host: str, port: int, token: str, tls: ssl.SSLContext | None = None) -> int:
        """Listen, at any free port where `port` is 0 or taken by somebody else; returns the port."""
        try:
            self._server = await self._listen(host, port, tls)
        except OSError:
            self._server = await self._listen(host, 0, tls)
        found: int = next(iter(self._server.sockets)).getsockname()[1]
        self._access = Access(token, found, tls is not None, is_loopback(host))
        return found

    async def _listen(self, host: str, port: int, tls: ssl.SSLContext | None) -> Server:
        return await serve(
            self._meet, host, port, ssl=tls, process_request=self._answer, max_size=MAX_ASKED_BYTES, max_queue=16,
            compression=None, write_limit=WAITING_BYTES, server_header=None,
        )  # fmt: skip

    async def close(self) -> None:
        if self._server:
            self._server.close()
            await self._server.wait_closed()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """A file of the page; None lets a WebSocket begin."""
        access, path = self._access, request.path.partition("?")[0]
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not access.host_is_ours(hosts[0]) or len(origins) > 1:
            return _plain(HTTPStatus.FORBIDDEN, "this page is known by another address\n")
        if not access.knows_token(request.path, "; ".join(request.headers.get_all("Cookie"))):
            return _plain(HTTPStatus.FORBIDDEN, "open the address that kinegraph printed: it holds a token\n")
        if path == SOCKET:
            ours = access.origin_is_ours(origins[0] if origins else None, hosts[0])
            full = len(self._shows.clients) >= MAX_CLIENTS
            refused = (
                "another web site may not look at this session\n"
                if not ours
                else "too many look at it\n"
                if full
                else ""
            )
            return _plain(HTTPStatus.FORBIDDEN, refused) if refused else None
        if path == "/metrics":
            return _response(HTTPStatus.OK, METRICS_TYPE, self._metrics().encode())
        if path.startswith(MODULES) and path.endswith(".js"):
            module = self._shows.modules.get(path[len(MODULES) : -len(".js")])
            return _response(HTTPStatus.OK, FILES["/page.js"][1], module.encode()) if module else _plain(*NO_PAGE)
        if path == AVATAR and self._avatar:
            return _response(HTTPStatus.OK, "model/gltf-binary", self._avatar)
        if path.startswith(REPORTS):
            return self._report(path.removeprefix(REPORTS))
        if path not in self._files:
            return _plain(*NO_PAGE)
        if (
            access.token and path == "/" and "?" in request.path
        ):  # the cookie takes over, and the token leaves the address
            more = (("Location", "./"), ("Set-Cookie", access.cookie))
            return _response(HTTPStatus.SEE_OTHER, "text/plain; charset=utf-8", b"", *more)
        if "gzip" in "".join(request.headers.get_all("Accept-Encoding")):
            response = _response(HTTPStatus.OK, self._files[path][1], self._packed[path], ("Content-Encoding", "gzip"))
        else:
            response = _response(HTTPStatus.OK, self._files[path][1], gzip.decompress(self._packed[path]))
        return response

    def _report(self, number: str) -> Response:
        reports = self._reports()
        try:
            body = Path(reports[int(number)] if number.isdigit() else "").read_bytes()
        except (OSError, IndexError):  # somebody has moved it
            return _plain(*NO_PAGE)
        return _response(HTTPStatus.OK, FILES["/"][1], body, policy=REPORT_POLICY)

    async def _meet(self, connection: ServerConnection) -> None:
        """One client, from its first message to its last."""
        connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)
        client = self._shows.visitor()
        self._shows.clients.add(client)
        speaking = asyncio.create_task(self._speak(connection, client))
        try:
            await connection.send(self._shows.greeting())
            async for message in connection:
                self._take(client, message)
        except (ConnectionClosed, ValueError):
            with contextlib.suppress(ConnectionClosed):
                await connection.close(1008, "not understood")
        finally:
            speaking.cancel()
            self._shows.clients.discard(client)
            self._shows.want()

    def _take(self, client: Looking, message: str | bytes) -> None:
        self._shows.take(client, self._understand(message))

    async def _speak(self, connection: ServerConnection, client: Looking) -> None:
        """Send news for as long as the client reads them; those of a slow one wait here, and only the newest are sent."""
        try:
            while True:
                await client.news.wait()
                client.news.clear()
                for message in self._shows.news_for(client):
                    await connection.send(message)
        except ConnectionClosed:
            return
        except Exception:
            log.exception("a view could not be made; its client is sent away")
            await connection.close(1011, "the server failed")


def goodbye(why: str) -> bytes:
    return encode({"t": "over", "why": why})


def _response(status: HTTPStatus, kind: str, body: bytes, *more: tuple[str, str], policy: str = "") -> Response:
    headers = HEADERS | ({"Content-Security-Policy": policy} if policy else {})
    sizes = (("Content-Type", kind), ("Content-Length", str(len(body))), ("Connection", "close"))
    return Response(status.value, status.phrase, Headers([*headers.items(), *sizes, *more]), body)


def _plain(status: HTTPStatus, text: str) -> Response:
    return _response(status, "text/plain; charset=utf-8", text.encode())


def tls_context(certificate: str, key: str) -> ssl.SSLContext | None:
    """What encrypts connections; None where no certificate was given. Raises OSError or ssl.SSLError for invalid files."""
    if not certificate:
        return None
    context: Any = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, key or None)
    return context  # type: ignore[no-any-return]


def refuse_unbuilt() -> None:
    """Raises KinegraphError where the page was not built."""
    try:
        [built(name) for name, _ in FILES.values()]
    except FileNotFoundError:
        raise KinegraphError(
            "the page has not been built: `python -m pip install -e .` builds it (from the npm registry)"
        ) from None
