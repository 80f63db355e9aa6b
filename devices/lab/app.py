"""The lab's server. Starlette and uvicorn, since the page's server answers GET alone and takes no bodies: a lab is sent forms and files."""

from __future__ import annotations

import asyncio
import json
import re
import secrets
import shutil
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import aclosing, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import structlog
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from kinegraph.devices.discovery.finders import finders, look
from kinegraph.devices.lab import jobs
from kinegraph.devices.lab.app_server import serve_app
from kinegraph.devices.lab.forms import form_of, reports_of
from kinegraph.devices.lab.guard import Guard
from kinegraph.devices.lab.proxy import as_request, page_file, page_socket, say_to
from kinegraph.devices.lab.results import result_of
from kinegraph.devices.lab.sessions import PAGE, LabSession, Sessions
from kinegraph.devices.lab.uses import PRESETS, USES, argument, graph_file, offered
from kinegraph.devices.page.access import Access, is_loopback
from kinegraph.devices.page.address import Address
from kinegraph.devices.page.serving import REPORT_POLICY, built
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import rewritten
from kinegraph.stream.graph.reading.yaml_lines import parse
from kinegraph.stream.system.atomic_file import private_folder, write_complete

BUILT = {
    "/": ("lab.html", "text/html; charset=utf-8"),
    "/lab.js": ("lab.js", "text/javascript; charset=utf-8"),
    "/lab.css": ("lab.css", "text/css; charset=utf-8"),
}
CONTROL_S = 12.0
"""Whoever has not been heard of for so long does not control a session any more."""
DEVICES_S = 5.0
EXPORTS = {
    "csv": "",
    "xdf": ".xdf",
    "matlab": ".mat",
    "xlsx": ".xlsx",
    "c3d": ".c3d",
    "edf": ".edf",
    "parquet": ".parquet",
}
"""Formats that a lab exports to, and how their files end; "": a folder, which is packed."""
CHECKED, REFERENCES = "checks", "references"
"""Folders of a lab: graphs as they were checked, and references for amplitudes."""
CHECK_COMMANDS = {
    "electrodes": ("emg", "check-electrodes"),
    "contacts": ("emg", "check-contacts"),
    "bed": ("sleep", "check"),
}
DOWNLOADS = ("pose-model", "camera-models")
"""What `kinegraph files fetch` brings."""
MAX_CHECKS = 4
MOST_UPLOAD = 8 << 30

log = structlog.get_logger(__name__)


class Lab:
    """All that requests share: the folder, who controls which session, and the devices that were found last."""

    def __init__(self, home: Path) -> None:
        self.home, self.sessions = home, Sessions(home)
        self._control: dict[str, tuple[str, float]] = {}
        self._found: list[dict[str, Any]] = []
        self._looked_s = -1e9
        self._looking = asyncio.Lock()
        self._checks: dict[str, tuple[jobs.Check, asyncio.Task[None]]] = {}

    # who controls ----------------------------------------------------------------------------------------------------

    def controller(self, session: str) -> str:
        """Who controls a session now; "" where no client does."""
        client, seen_s = self._control.get(session, ("", 0.0))
        return client if time.monotonic() - seen_s < CONTROL_S else ""

    def controls(self, session: str, client: str, *, take: bool = False) -> bool:
        """Whether a client controls a session; the first one does, and whoever takes control over."""
        mine = bool(client) and (take or self.controller(session) in ("", client))
        if mine:
            self._control[session] = (client, time.monotonic())
        return mine

    # requests --------------------------------------------------------------------------------------------------------

    async def built(self, request: Request) -> Response:
        name, kind = BUILT[request.url.path]
        return Response(built(name), headers={"Content-Type": kind})

    async def get_home(self, request: Request) -> Response:
        def found() -> dict[str, Any]:
            disk = shutil.disk_usage(self.home)
            sessions = [one.summary() for one in self.sessions.all()]
            for one in sessions:
                self._settle(one)
            return {**offered(self.home), "sessions": sessions, "free_bytes": disk.free, "folder": str(self.home)}

        return JSONResponse(await asyncio.to_thread(found))

    def _settle(self, one: dict[str, Any]) -> None:
        """The result of a session that has ended, read once."""
        if not one["runs"] and one["result"] == "" and one["kind"] != "import":
            session = self.sessions.of(one["id"])
            session.keep_reports()
            one["result"] = result_of(session.folder) or "-"
            session.note(result=one["result"])

    async def get_devices(self, request: Request) -> Response:
        async with self._looking:
            if time.monotonic() - self._looked_s > DEVICES_S:
                self._found = await _devices_beside()
                self._looked_s = time.monotonic()
        return JSONResponse(self._found)

    async def get_form(self, request: Request) -> Response:
        graph = request.query_params.get("graph", "")
        form = await asyncio.to_thread(form_of, graph_file(self.home, graph))
        title, what = USES.get(graph, (form["name"].replace("_", " "), form["summary"]))
        return JSONResponse({**form, "graph": graph, "title": title, "summary": what})

    async def post_preset(self, request: Request) -> Response:
        asked = await as_request(request)
        name = re.sub(r"[^\w -]+", "", str(asked["name"])).strip()
        if not name:
            raise KinegraphError("a preset needs a name")
        file = graph_file(self.home, str(asked["graph"]))
        text = await asyncio.to_thread(rewritten, file, dict(asked["values"]))
        private_folder(self.home / PRESETS)
        path = self.home / PRESETS / f"{name}.yaml"
        if path.exists() and not asked.get("replace"):
            raise KinegraphError(f"there is a preset {name!r} already; choose another name")
        write_complete(path, text)
        return JSONResponse({"graph": f"{PRESETS}/{path.name}"})

    async def post_check(self, request: Request) -> Response:
        """Begin a check: of the electrodes, of the foot contacts, or of the camera over the bed."""
        asked = await as_request(request)
        command = CHECK_COMMANDS.get(str(asked["kind"]))
        if command is None:
            raise KinegraphError(f"there is no check {asked['kind']!r}")
        path = await self._checked_graph(asked)
        simulate = ["--simulate"] if asked.get("simulate") else []
        return self._begin(*command, str(path.relative_to(self.home)), *simulate, "--json")

    async def post_download(self, request: Request) -> Response:
        """Begin to download networks that a graph needs: its progress is that of a check."""
        name = str((await as_request(request))["name"])
        if name not in DOWNLOADS:
            raise KinegraphError(f"there is no download {name!r}")
        return self._begin("files", "fetch", name)

    def _begin(self, *arguments: str) -> Response:
        """Begin a command that reports how far it is."""
        check, name = jobs.Check(), secrets.token_hex(8)
        task = asyncio.create_task(check.run(self.home, *arguments))
        while len(self._checks) >= MAX_CHECKS:
            self._checks.pop(next(iter(self._checks)))[1].cancel()
        self._checks[name] = check, task
        return JSONResponse({"id": name})

    async def post_look(self, request: Request) -> Response:
        """What the camera sees now, for drawing the bed's region; never kept, and never shown on another machine."""
        if request.client is None or not is_loopback(request.client.host):
            raise KinegraphError("the camera's picture is shown on the lab's own machine alone")
        asked = await as_request(request)
        path = await self._checked_graph(asked)
        simulate = ["--simulate"] if asked.get("simulate") else []
        frames = jobs.printed(self.home, "sleep", "check", str(path.relative_to(self.home)), "--look", *simulate)
        first = await anext(frames)

        async def all_of() -> AsyncIterator[bytes]:
            async with aclosing(frames):
                yield first
                async for piece in frames:
                    yield piece

        return StreamingResponse(all_of(), media_type="application/octet-stream")

    async def _checked_graph(self, asked: dict[str, Any]) -> Path:
        """The graph with the values of its form, as a file."""
        graph = graph_file(self.home, str(asked["graph"]))
        text = await asyncio.to_thread(rewritten, graph, dict(asked["values"]))
        private_folder(self.home / CHECKED)
        path = self.home / CHECKED / f"{graph.stem}.yaml"
        write_complete(path, text)
        return path

    async def get_check(self, request: Request) -> Response:
        check, _ = self._checks.get(request.path_params["id"], (None, None))
        if check is None:
            raise KinegraphError("there is no such check")
        try:
            found = json.loads(check.found) if check.found else {}
        except ValueError:
            found = {}
        return JSONResponse({"status": check.printed, "code": check.code, "found": found})

    async def post_calibrate(self, request: Request) -> Response:
        """A reference for amplitudes from a session of strongest contractions."""
        session = self._session(request)
        private_folder(self.home / REFERENCES)
        who = re.sub(r"[^\w.-]+", "_", str(session.facts.get("subject", ""))).strip("._") or session.id
        out = f"{REFERENCES}/{who}.mvc.json"
        code, text = await jobs.kinegraph(
            self.home, "emg", "calibrate", "mvc", str(session.folder), "-o", out, "--overwrite"
        )
        if code:
            raise KinegraphError(text.removeprefix("kinegraph: ")[-600:])
        return JSONResponse({"file": out})

    async def post_session(self, request: Request) -> Response:
        asked = await as_request(request)
        graph = str(asked["graph"])
        name = graph_file(self.home, graph).stem
        session = await asyncio.to_thread(
            lambda: self.sessions.run(
                argument(self.home, graph),
                name,
                dict(asked["values"]),
                simulate=bool(asked.get("simulate")),
                kind="mvc" if asked.get("kind") == "mvc" else "session",
            )
        )
        return JSONResponse({"id": session.id})

    async def get_session(self, request: Request) -> Response:
        session, client = self._session(request), request.headers.get("x-client", "")

        def found() -> dict[str, Any]:
            one = session.summary()
            self._settle(one)
            return {
                **one,
                "values": session.facts.get("values", {}),
                "page": bool(session.page),
                "output": PAGE.sub("", session.output)[-4000:].strip(),
                "files": [path.name for path in session.files()] if not one["runs"] else [],
                "recorded": any(session.folder.rglob("*.mcap")),
                "free_bytes": shutil.disk_usage(self.home).free,
                "now_s": time.time(),
            }

        mine = self.controls(session.id, client) if session.runs else False
        return JSONResponse({**await asyncio.to_thread(found), "controls": mine})

    async def post_session_act(self, request: Request) -> Response:
        session, client = self._session(request), request.headers.get("x-client", "")
        asked, act = await as_request(request), request.path_params["act"]
        if act == "remarks":
            session.note(remarks=str(asked["text"])[:10_000])
            return JSONResponse({})
        if not self.controls(session.id, client, take=act == "control"):
            raise KinegraphError("somebody else controls this session; take control first")
        if act == "stop":
            session.stop()
        elif act == "mark" and not await say_to(
            session, {"do": "mark", "text": str(asked["text"])[:64], "at": asked.get("at")}
        ):
            raise KinegraphError("the session does not answer: not marked")
        elif act == "tell" and not await say_to(
            session, {"do": "tell", "node": str(asked["node"]), "text": str(asked["text"])}
        ):
            raise KinegraphError("the session does not answer: not set")
        return JSONResponse({})

    async def delete_session(self, request: Request) -> Response:
        await asyncio.to_thread(self._session(request).delete)
        return JSONResponse({})

    async def get_file(self, request: Request) -> Response:
        session, files = self._session(request), self._session(request).files()
        path = next((one for one in files if one.name == request.path_params["name"]), None)
        if path is None:
            raise HTTPException(404)
        page = path.suffix == ".html" and "save" not in request.query_params
        headers = {"Content-Security-Policy": REPORT_POLICY + "; frame-ancestors 'self'"}
        kind = "text/html; charset=utf-8" if page else "application/octet-stream"
        del session
        return FileResponse(path, media_type=kind, headers=headers, filename=None if page else path.name)

    async def post_pdf(self, request: Request) -> Response:
        session = self._session(request)
        page = next((path for path in session.files() if path.suffix == ".html"), None)
        if page is None:
            raise KinegraphError("this session has no report")
        into = page.with_suffix(".pdf")
        if why := await jobs.pdf(page, into):
            raise KinegraphError(why)
        return JSONResponse({"file": into.name})

    async def post_export(self, request: Request) -> Response:
        session, asked = self._session(request), await as_request(request)
        kind = str(asked["format"])
        if kind not in EXPORTS:
            raise KinegraphError(f"there is no format {kind!r}")
        folder = session.folder / "exports"
        private_folder(folder)
        out = folder / f"{session.id}{EXPORTS[kind]}"
        code, text = await jobs.kinegraph(
            self.home, "files", "export", str(session.folder), "--format", kind, "-o", str(out), "--overwrite"
        )
        if code:
            raise KinegraphError(text.removeprefix("kinegraph: ")[-600:])
        if out.is_dir():
            await asyncio.to_thread(shutil.make_archive, str(out), "zip", out)
            shutil.rmtree(out)
            out = out.with_name(out.name + ".zip")
        return JSONResponse({"file": out.name, "note": _left_out(text)})

    async def post_compare(self, request: Request) -> Response:
        session, asked = self._session(request), await as_request(request)
        others = [self.sessions.of(str(one)).folder for one in asked["with"]]
        out = session.folder / "comparison"
        code, text = await jobs.kinegraph(
            self.home, "emg", "compare", *map(str, [*others, session.folder]), "-o", str(out), "--overwrite"
        )
        if code:
            raise KinegraphError(text.removeprefix("kinegraph: ")[-600:])
        return JSONResponse({"file": "comparison.html"})

    async def post_replay(self, request: Request) -> Response:
        """The session's graph on its recording, with other values, into a new session."""
        session, asked = self._session(request), await as_request(request)
        facts, values = session.facts, dict(asked["values"])
        if not facts.get("graph"):
            raise KinegraphError("an imported recording has no graph; replay it with one of the uses")

        def begin() -> LabSession:
            folder = self.sessions.new(str(facts["name"]))
            reports = reports_of(graph_file(self.home, str(facts["graph"])))
            merged = {**dict(facts.get("values", {})), **values}
            settings = [part for key, value in merged.items() for part in ("--set", f"{key}={json.dumps(value)}")]
            speaking = [part for node in reports for part in ("--speak", node)]
            arguments = [
                "replay",
                str(facts["graph"]),
                str(session.folder),
                *settings,
                *speaking,
                "-o",
                str(folder),
                "-q",
            ]
            kept = {
                "graph": facts["graph"],
                "name": facts["name"],
                "subject": facts.get("subject", ""),
                "values": merged,
            }
            return self.sessions.begin(
                folder, arguments, {"kind": "replay", "devices": f"replay of {session.id}", **kept}
            )

        return JSONResponse({"id": (await asyncio.to_thread(begin)).id})

    async def post_import(self, request: Request) -> Response:
        """A file that was dropped: into a recording of its own."""
        name = Path(request.query_params.get("name", "")).name
        if not re.fullmatch(r"[^/\\\0]{1,200}", name) or name.startswith("."):
            raise KinegraphError("the file needs a name")
        folder = self.sessions.new(Path(name).stem)
        source = folder / "imported" / name
        private_folder(source.parent)
        size = 0
        with source.open("wb") as file:
            async for piece in request.stream():
                size += len(piece)
                if size > MOST_UPLOAD:
                    raise KinegraphError("the file is too large")
                file.write(piece)
        into = folder / "session.0000.mcap"
        arguments = ["files", "import", str(source), "-o", str(into)]
        facts = {"kind": "import", "name": name, "graph": "", "subject": "", "devices": "imported"}
        return JSONResponse({"id": self.sessions.begin(folder, arguments, facts).id})

    async def get_page(self, request: Request) -> Response:
        return await page_file(self._session(request), request.path_params["path"])

    async def page_socket(self, socket: WebSocket) -> None:
        client, id = socket.query_params.get("client", ""), socket.path_params["id"]
        try:
            session = self.sessions.of(id)
        except KinegraphError:
            await socket.close(1008)
            return
        await page_socket(session, socket, lambda: self.controls(id, client))

    def _session(self, request: Request) -> LabSession:
        return self.sessions.of(request.path_params["id"])


async def _devices_beside() -> list[dict[str, Any]]:
    """The devices that are found, in a thread that the end of the lab does not wait for."""
    loop = asyncio.get_running_loop()
    given: asyncio.Future[list[dict[str, Any]]] = loop.create_future()

    def take(found: list[dict[str, Any]]) -> None:
        if not given.done():  # who asked may have left
            given.set_result(found)

    def run() -> None:
        found: list[dict[str, Any]] = []
        try:
            found = _devices()
        finally:
            with suppress(RuntimeError):  # the lab has ended
                loop.call_soon_threadsafe(take, found)

    threading.Thread(target=run, name="devices", daemon=True).start()
    return await given


def _devices() -> list[dict[str, Any]]:
    found = []
    for kind, finder in finders().items():
        here, failed = look(finder)
        found += [{**asdict(one), **_node(one.yaml)} for one in here]
        if failed:
            log.info("devices could not be asked", kind=kind, error=failed)
    return found


def _left_out(text: str) -> str:
    """What an export says beside what it has written."""
    return "\n".join(line for line in text.splitlines() if " samples to " not in line)[-600:]


def _node(yaml: str) -> dict[str, Any]:
    """What a device's YAML says: the source that reads it, and its parameters."""
    try:
        given = parse(yaml, "").plain() if yaml else {}
    except KinegraphError:
        given = {}
    given = given if isinstance(given, dict) else {}
    return {"use": given.pop("use", ""), "parameters": given}


async def _refused(request: Request, error: Exception) -> Response:
    """Errors that people can act on, in words."""
    return JSONResponse({"error": str(error)}, 400)


def app_of(home: Path, access: Access) -> ASGIApp:
    """The lab as an ASGI application."""
    lab = Lab(home)
    one = "/api/sessions/{id}"

    def post(path: str, answer: Callable[[Request], Awaitable[Response]]) -> Route:
        return Route(path, answer, methods=["POST"])

    routes = [
        *(Route(path, lab.built) for path in BUILT),
        Route("/api/home", lab.get_home),
        Route("/api/devices", lab.get_devices),
        Route("/api/form", lab.get_form),
        post("/api/presets", lab.post_preset),
        post("/api/import", lab.post_import),
        post("/api/checks", lab.post_check),
        post("/api/downloads", lab.post_download),
        post("/api/look", lab.post_look),
        Route("/api/checks/{id}", lab.get_check),
        post("/api/sessions", lab.post_session),
        Route(one, lab.get_session),
        Route(one, lab.delete_session, methods=["DELETE"]),
        Route(one + "/files/{name}", lab.get_file),
        post(one + "/pdf", lab.post_pdf),
        post(one + "/export", lab.post_export),
        post(one + "/compare", lab.post_compare),
        post(one + "/replay", lab.post_replay),
        post(one + "/calibrate", lab.post_calibrate),
        post(one + "/{act:str}", lab.post_session_act),
        WebSocketRoute("/sessions/{id}/socket", lab.page_socket),
        Route("/sessions/{id}/{path:path}", lab.get_page),
    ]
    handlers: dict[Any, Any] = {KinegraphError: _refused, ValueError: _refused, KeyError: _refused}
    return Guard(Starlette(routes=routes, exception_handlers=handlers), access)


async def serve(home: Path, address: Address, *, duration_s: float, browser: bool) -> None:
    """Serve a lab until Ctrl-C. Sessions go on."""
    name, after = "lab", "sessions go on"
    try:
        await serve_app(
            lambda access: app_of(home, access), name, after, address, duration_s=duration_s, browser=browser
        )
    finally:  # Ctrl-C raises here
        await jobs.settled()
