"""Who may use the lab: the page's rules of access, before every request and every WebSocket."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kinegraph.devices.page.access import HEADERS, Access

POLICY = HEADERS["Content-Security-Policy"] + "; frame-src 'self'"
MOST_BODY = 1 << 20
"""Bytes of a request that is no upload."""
UPLOADS = "/api/import"


class Guard:
    """Lets in those who show the token, at an address of ours, and from no other web site."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        path = scope["path"] + ("?" + scope["query_string"].decode("latin-1") if scope["query_string"] else "")
        refused = self._refusal(scope, headers, path)
        if scope["type"] == "websocket" and refused:
            await receive()
            await send({"type": "websocket.close", "code": 1008})
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        if refused:
            await PlainTextResponse(refused, 403, HEADERS)(scope, receive, send)
        elif self._access.token and scope["path"] == "/" and scope["query_string"]:
            moved = RedirectResponse("/", 303, HEADERS)  # the cookie takes over, and the token leaves the address
            moved.headers["Set-Cookie"] = self._access.cookie
            await moved(scope, receive, send)
        elif scope["path"] != UPLOADS and int(headers.get("content-length", "0") or 0) > MOST_BODY:
            await PlainTextResponse("too long\n", 413, HEADERS)(scope, receive, send)
        else:
            await self._app(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope, headers: Headers, path: str) -> str:
        access, hosts = self._access, headers.getlist("host")
        if len(hosts) != 1 or not access.host_is_ours(hosts[0]):
            return "this lab is known by another address\n"
        if not access.knows_token(path, "; ".join(headers.getlist("cookie"))):
            return "open the address that kinegraph printed: it holds a token\n"
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if changes and not access.origin_is_ours(headers.get("origin"), hosts[0]):
            return "another web site may not use this lab\n"
        return ""


def _with_headers(send: Send) -> Send:
    """Answers carry what browsers must refuse; an answer's own policy stays."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            given = [(name.lower(), value) for name, value in message.get("headers", [])]
            names = {name for name, _ in given}
            ours = {**HEADERS, "Content-Security-Policy": POLICY}
            more = [(n.lower().encode(), v.encode()) for n, v in ours.items() if n.lower().encode() not in names]
            message = {**message, "headers": [*given, *more]}
        await send(message)

    return sent
