"""A session's page through the lab: one address and one token for both, and marks only from whoever controls the session."""

from __future__ import annotations

import asyncio
import urllib.error
import urllib.request
from contextlib import suppress
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException

from kinegraph.devices.lab.sessions import LabSession
from kinegraph.devices.page.access import COOKIE, HEADERS

CHANGES = ("mark", "tell")
"""What changes a session; everything else only looks at it."""
KEPT = ("content-type", "content-security-policy")
PATIENCE_S = 10.0
MOST_BYTES = 1 << 26


def _cookie(page: str) -> str:
    place = urlsplit(page)
    return f"{COOKIE}-{place.port}={parse_qs(place.query).get('token', [''])[0]}"


async def page_file(session: LabSession, path: str) -> Response:
    """A file of the session's page."""
    page = session.page
    if not page:
        return PlainTextResponse("the page is not served\n", 404)
    place = urlsplit(page)
    request = urllib.request.Request(f"http://{place.netloc}/{path}", headers={"Cookie": _cookie(page)})
    try:
        body, kind, policy = await asyncio.to_thread(_fetched, request)
    except urllib.error.HTTPError as error:
        return PlainTextResponse("there is no such page\n", error.code)
    except OSError:
        return PlainTextResponse("the page does not answer\n", 502)
    policy = policy.replace("frame-ancestors 'none'", "frame-ancestors 'self'")
    return Response(body, headers={**HEADERS, "Content-Type": kind, "Content-Security-Policy": policy})


def _fetched(request: urllib.request.Request) -> tuple[bytes, str, str]:
    with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request, timeout=PATIENCE_S) as answer:
        kind, policy = (answer.headers.get(name, "") for name in KEPT)
        return answer.read(MOST_BYTES), kind, policy


async def page_socket(session: LabSession, client: WebSocket, may_change: Any) -> None:
    """Pass messages on, both ways, until either end leaves; those that change something only while `may_change()`."""
    page = session.page
    await client.accept()
    if not page:
        await client.close(1013, "the page is not served")
        return
    place = urlsplit(page)
    try:
        async with connect(
            f"ws://{place.netloc}/socket", additional_headers={"Cookie": _cookie(page)}, max_size=None, compression=None, proxy=None
        ) as server:  # fmt: skip
            ways = [asyncio.create_task(_up(client, server, may_change)), asyncio.create_task(_down(server, client))]
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
    except (OSError, WebSocketException):
        pass
    with suppress(RuntimeError, WebSocketDisconnect):
        await client.close()


async def _up(client: WebSocket, server: ClientConnection, may_change: Any) -> None:
    with suppress(WebSocketDisconnect, ConnectionClosed):
        while True:
            text = await client.receive_text()
            if _asks(text) not in CHANGES or may_change():
                await server.send(text)


async def _down(server: ClientConnection, client: WebSocket) -> None:
    with suppress(WebSocketDisconnect, ConnectionClosed, RuntimeError):
        async for message in server:
            await (client.send_bytes(message) if isinstance(message, bytes) else client.send_text(message))


def _asks(text: str) -> str:
    try:
        return str(msgspec.json.decode(text)["do"])
    except (msgspec.DecodeError, KeyError, TypeError):
        return ""


async def say_to(session: LabSession, message: dict[str, Any]) -> bool:
    """Send one message to a session's page; whether it could be sent."""
    page = session.page
    if not page:
        return False
    place = urlsplit(page)
    try:
        async with connect(
            f"ws://{place.netloc}/socket", additional_headers={"Cookie": _cookie(page)}, max_size=None, compression=None, proxy=None
        ) as server:  # fmt: skip
            await server.recv()  # its greeting: from now on it listens
            await server.send(msgspec.json.encode(message).decode())
    except (OSError, WebSocketException):
        return False
    return True


async def as_request(request: Request) -> dict[str, Any]:
    """The object in a request's body. Raises ValueError."""
    found = msgspec.json.decode(await request.body())
    if not isinstance(found, dict):
        raise ValueError("a request is an object")
    return found
