"""The ward's web server: the page, what it shows, acknowledgements, orders, and a bed's own page through it."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from kinegraph.devices.lab.app_server import serve_app
from kinegraph.devices.lab.guard import Guard
from kinegraph.devices.lab.proxy import as_request, page_file, page_socket
from kinegraph.devices.lab.sessions import FACTS as SESSION_FACTS
from kinegraph.devices.lab.sessions import LabSession, Sessions
from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.messages import DAMAGE, FACTS, PREFIX
from kinegraph.devices.nats.panels import panels_here
from kinegraph.devices.nats.server import NAME
from kinegraph.devices.page.access import Access
from kinegraph.devices.page.address import Address
from kinegraph.devices.page.serving import built
from kinegraph.devices.ward.centre import Centre
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete

BUILT = {
    "/": ("ward.html", "text/html; charset=utf-8"),
    "/ward.js": ("ward.js", "text/javascript; charset=utf-8"),
    "/lab.css": ("lab.css", "text/css; charset=utf-8"),
}


class WardPage:
    """What requests share."""

    def __init__(self, centre: Centre) -> None:
        self.centre, self.sessions = centre, Sessions(centre.home)

    async def built(self, request: Request) -> Response:
        name, kind = BUILT[request.url.path]
        return Response(built(name), headers={"Content-Type": kind})

    async def get_ward(self, request: Request) -> Response:
        return JSONResponse(await asyncio.to_thread(self.centre.state))

    async def post_acknowledge(self, request: Request) -> Response:
        asked = await as_request(request)
        by = str(asked.get("by", ""))[:80]
        done = self.centre.book.acknowledge(request.path_params["id"], by, time.time())
        return JSONResponse({"acknowledged": done})

    async def post_order(self, request: Request) -> Response:
        """Roll out a graph or a version to some beds, or have them go back."""
        asked = await as_request(request)
        order: dict[str, Any] = {name: asked[name] for name in ("graph", "version", "back") if name in asked}
        if len(order) != 1:
            raise KinegraphError("an order is one of graph, version and back")
        return JSONResponse({"id": self.centre.roll_out([str(bed) for bed in asked["beds"]], order)})

    async def post_open(self, request: Request) -> Response:
        """Start the page of a bed: its streams in a graph of the centre."""
        bed = request.path_params["bed"]
        if not NAME.fullmatch(bed) or bed not in self.centre.beds:
            raise KinegraphError("there is no such bed")
        session = await asyncio.to_thread(self._opened, bed)
        return JSONResponse({"id": session.id, "page": bool(session.page)})

    def _opened(self, bed: str) -> LabSession:
        folder = private_folder(self.centre.home / "sessions" / f"bed-{bed}")
        session = LabSession(folder)
        if (folder / SESSION_FACTS).is_file() and session.runs:
            return session
        write_complete(folder / "view.yaml", view_graph(self.centre, bed))
        arguments = ["run", str(folder / "view.yaml"), "--no-record", "--view", "none", "--page-at", "127.0.0.1:0"]
        return self.sessions.begin(folder, arguments, {"kind": "view", "graph": bed, "name": bed})

    async def get_view(self, request: Request) -> Response:
        session = self.sessions.of(request.path_params["id"])
        return JSONResponse({"page": bool(session.page), "runs": session.runs, "output": session.output[-2000:]})

    async def get_page(self, request: Request) -> Response:
        return await page_file(self.sessions.of(request.path_params["id"]), request.path_params["path"])

    async def page_socket(self, socket: WebSocket) -> None:
        try:
            session = self.sessions.of(socket.path_params["id"])
        except KinegraphError:
            await socket.close(1008)
            return
        await page_socket(session, socket, lambda: False)


def view_graph(centre: Centre, bed: str) -> str:
    """A graph of all streams of a bed, for its page, with the panels of the bed's own."""
    link = centre.link
    before = f"{PREFIX}.{bed}.facts.spec."
    info = link.call(link.stream.stream_info(FACTS, subjects_filter=f"{before}>"))
    streams = sorted(where.removeprefix(before) for where in info.state.subjects or {})
    if not streams:
        raise KinegraphError(f"bed {bed} has not published any stream yet")
    server = {name: value for name in link.server.__slots__ if (value := getattr(link.server, name))}
    nodes = {
        name.replace(".", "_"): {
            "use": "devices.nats.StreamInlet", "bed": bed, "stream": name, "server": server, "start": "new",
            "position": str(centre.home / "positions"),
        }
        for name in streams
    }  # fmt: skip
    panels: list[dict[str, Any]] = []
    with suppress(*DAMAGE):
        sent = link.call(links.fact(link, f"{bed}.facts.panels"))
        panels = panels_here(json.loads(sent or b"[]"), {name: name.replace(".", "_") for name in streams})
    return json.dumps({"name": bed, "nodes": nodes, **({"page": {"panels": panels}} if panels else {})}, indent=1)


async def _refused(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 400)


def app_of(centre: Centre, access: Access) -> ASGIApp:
    """The ward as an ASGI application."""
    page = WardPage(centre)

    def post(path: str, answer: Callable[[Request], Awaitable[Response]]) -> Route:
        return Route(path, answer, methods=["POST"])

    routes = [
        *(Route(path, page.built) for path in BUILT),
        Route("/api/ward", page.get_ward),
        post("/api/alarms/{id}/acknowledge", page.post_acknowledge),
        post("/api/orders", page.post_order),
        post("/api/beds/{bed}/open", page.post_open),
        Route("/api/views/{id}", page.get_view),
        WebSocketRoute("/sessions/{id}/socket", page.page_socket),
        Route("/sessions/{id}/{path:path}", page.get_page),
    ]
    handlers: dict[Any, Any] = {KinegraphError: _refused, ValueError: _refused, KeyError: _refused, OSError: _refused}
    return Guard(Starlette(routes=routes, exception_handlers=handlers), access)


async def serve(centre: Centre, address: Address, *, duration_s: float, browser: bool) -> None:
    """Serve the ward until Ctrl-C. Beds go on."""
    name, after = "ward", "beds go on"
    try:
        await serve_app(
            lambda access: app_of(centre, access), name, after, address, duration_s=duration_s, browser=browser
        )
    finally:  # Ctrl-C raises here
        for session in Sessions(centre.home).all():
            session.stop()
