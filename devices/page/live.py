"""A live session's way to its page: streams that somebody looks at go to the server's process, and what people ask for comes back.

The graph's own thread puts chunks into a bounded channel, and some 30 times a second writes those that have come together to the server, in
one system call that never waits: no other thread is woken. Pictures, the engine's state and the log are written by a thread of the lane's
own. Where the server is slow, or gone, views are dropped, and samples never wait. A server that ends is started again.
"""

from __future__ import annotations

import importlib.util
import json
import threading
import time
from collections.abc import Callable, MutableMapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import structlog

from kinegraph.devices.page.access import is_loopback
from kinegraph.devices.page.address import parsed
from kinegraph.devices.page.avatar_file import checked_avatar
from kinegraph.devices.page.marks import MARKS, SPEC, Marks, shown_with
from kinegraph.devices.page.server_process import ServerProcess
from kinegraph.devices.page.serving import refuse_unbuilt
from kinegraph.devices.page.takes import FOLDER, Takes
from kinegraph.devices.page.transfer.catalogue import (
    described,
    hello,
    is_newest_only,
    offered,
    own_modules,
    with_avatar,
)
from kinegraph.devices.page.transfer.channel import PageChannel, Portion, message
from kinegraph.devices.page.transfer.handover import MAX_LINES, Handover, log_line
from kinegraph.devices.page.transfer.wire import encode
from kinegraph.stream.chunk import NS
from kinegraph.stream.engine.status import Outcome, Table
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph import Graph
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.stream.engine.pipeline import Pipeline
    from kinegraph.stream.engine.replay import Replay
    from kinegraph.stream.engine.session import Session

START_S = 20.0
"""How long a server is waited for when a session begins."""
ALSO = ("kind", "time", "level")
"""What a recorded line of the log has beside its facts."""
FOXGLOVE_PORT = 8765

log = structlog.get_logger(__name__)


class LivePage:
    """Shows a session in browsers until it is left.

    server   the module that is run to serve it
    called   what people call it
    """

    server: ClassVar[str] = "kinegraph.devices.page.server"
    called: ClassVar[str] = "page"

    def __init__(
        self,
        graph: Graph,
        address: str = "",
        certificate: str = "",
        key: str = "",
        *,
        mode: str = "live",
        avatar: Path | None = None,
        no_token: bool = False,
    ) -> None:
        """`address` is HOST, HOST:PORT or :PORT; `avatar` a VRM file that the graph's avatar gives way to. Raises KinegraphError where the
        page cannot be served."""
        self._graph, self._mode = graph, mode
        self._address = parsed(address, certificate, key, no_token=no_token)
        self._address.check()
        self.refuse_missing()
        self._avatar = checked_avatar(avatar or graph.page.avatar)
        self._avatar_asked = avatar is not None
        self._modules = own_modules(graph.page)
        self._specs = offered(graph, outside=not is_loopback(self._address.host))
        self._steered: dict[str, Callable[..., None]] = {}
        self._length_s = 0.0
        self._takes = Takes([], {})
        self._marks: Marks | None = None
        self._over, self._listening = threading.Event(), threading.Event()
        self._handover = Handover(self._new_channel(), self._over, live=mode == "live")
        self._port, self._t0 = self._address.port, time.time_ns()
        self._said, self._began_s = False, time.time()
        self._pipeline: Pipeline | None = None
        self._samples: dict[str, int] = {}
        self._counted_s = 0.0
        process = ServerProcess(self.server, self.called, self, self._handover, self._over)
        self._thread = threading.Thread(target=process.run, name="page", daemon=True)

    def url(self, port: int) -> str:
        """The address that is printed."""
        return self._address.url(port)

    @property
    def address(self) -> str:
        """Where it is served, once it is."""
        return self.url(self._port)

    def refuse_missing(self) -> None:
        """Raises KinegraphError where what it is served by is not there."""
        refuse_unbuilt()

    # the session's side ----------------------------------------------------------------------------------------------

    def attach(self, session: Session) -> None:
        """Observe what is to be shown; called before the session runs."""
        self._t0 = session.clock.now()
        self._takes = Takes(self._hello()["panels"], self._specs)
        self.observe(session.pipeline)
        self._steered = {"mark": lambda text, at: session.mark(text, self._onset(at)), "tell": session.tell}
        if self._takes.name:
            self._takes.observe(session.pipeline)
            self._steered["take"] = lambda name, on: self._take(session, name, on=on)

    def _take(self, session: Session, name: str, *, on: bool) -> None:
        """Begin a take, or end it and write its files beside the recording."""
        if on:
            session.mark(f"take {self._takes.begin(name)}")
            return
        try:
            files = self._takes.end(Path(session.folder or ".") / FOLDER)
        except KinegraphError as error:
            log.warning("take not written", why=str(error))
            return
        session.mark(f"take {files[0].stem} ends")
        log.info("take written", files=", ".join(map(str, files)))

    def replays(self, replay: Replay) -> None:
        """Observe a replay; one that begins again is shown from its beginning."""
        recording, pace = replay.recording, replay.pace
        self._t0 = recording.begin_of_inputs
        if not self._length_s:
            self._marks = Marks(recording.path)
            self._specs = {**self._specs, MARKS: SPEC}
            self._handover.channel = self._new_channel()
            self._handover.lines = [
                log_line(
                    e["time"] / NS,
                    str(e.get("level", "info")),
                    str(e["kind"]),
                    {k: v for k, v in e.items() if k not in ALSO},
                )
                for e in recording.log[-MAX_LINES:]
            ]
        else:
            self._handover.channel.forget()
            self._handover.channel.announce(encode({"t": "again"}), *self._marked())
        self.observe(replay.pipeline)
        replay.view = self
        self._length_s = max(replay.length_s, 1e-9)
        if pace:
            self._steered = {"pace": pace.go, "step": pace.step, "seek": pace.seek}
            pace.report_to(lambda at, speed: self._set_pace(at, speed))

    def _new_channel(self) -> PageChannel:
        return PageChannel([is_newest_only(spec) for spec in self._specs.values()])

    def _set_pace(self, at: float, speed: float) -> None:
        self._handover.pace = encode({"t": "pace", "at": at, "speed": speed, "length": self._length_s})

    def _marked(self) -> list[bytes]:
        """The marks of the recording, as a message."""
        chunk = self._marks.chunk() if self._marks else None
        if chunk is None or not len(chunk.time):
            return []
        header, *numbers = message(Portion(len(self._specs) - 1, [chunk], 0))
        return [b"".join((bytes(header), *(bytes(part) for part in numbers)))]

    def observe(self, pipeline: Pipeline) -> None:
        """Observe a pipeline's edges; those that a replay does not compute have no observers."""
        self._pipeline = pipeline
        for number, name in enumerate(self._specs):
            if name in pipeline.edges:
                pipeline.edges[name].observers.append(self._handover.channel.observer(number))

    def _onset(self, at: float | None) -> int | None:
        return None if at is None else self._t0 + round(at * NS)

    def update(self, table: Table) -> None:
        """Take the newest metrics."""
        facts = {name: {key: value for key, value in row.items() if key in SHOWN} for name, row in table.items()}
        self._handover.state = encode(
            {"t": "state", "table": facts, "dropped": self._handover.channel.dropped, "edges": self._rates()}
        )

    def starting(self, text: str, over: bool) -> None:
        """How far the compilation of kernels is, and whether it is over."""
        told = "waiting for devices" if over else text
        self._handover.state = encode({"t": "state", "table": {}, "dropped": 0, "starting": told})

    def _rates(self) -> dict[str, float]:
        """Samples per second of every edge since this was asked last."""
        edges = self._pipeline.edges if self._pipeline else {}
        counts = {name: edge.samples for name, edge in edges.items()}
        before, self._samples = self._samples, counts
        then, self._counted_s = self._counted_s, time.monotonic()
        lasted = self._counted_s - then
        return {name: round((count - before[name]) / lasted, 2) for name, count in counts.items() if name in before}

    def rest(self, outcome: Outcome) -> None:
        """The session has ended, and its page stays: it shows that, and links the reports."""
        failed = f" with an error: {outcome.error}" if outcome.error else ""
        reports = [str(path.resolve()) for file in outcome.files.values() for path in _pages(Path(file), self._began_s)]
        self._handover.note(encode({"t": "over", "why": f"the session has ended{failed}", "reports": reports}))

    def __enter__(self) -> Self:
        self._before = structlog.get_config()["processors"]
        structlog.configure(processors=[self._note, *self._before])
        self._thread.start()
        self._listening.wait(START_S)
        return self

    def __exit__(self, *_: object) -> None:
        structlog.configure(processors=self._before)
        self._over.set()
        self._thread.join(5)

    def _note(self, _logger: Any, level: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        """A line of the log, on its way to wherever it goes."""
        facts = {key: value for key, value in event.items() if key not in ("event", "exc_info")}
        self._handover.note(log_line(time.time(), level, str(event.get("event", "")), facts))
        return event

    # what the server's process asks for ------------------------------------------------------------------------------

    def options(self) -> str:
        """Where the server is to listen, and the avatar; the port is that which it had before."""
        return json.dumps(asdict(self._address) | {"port": self._port, "avatar": str(self._avatar)})

    def greeting(self) -> list[bytes]:
        """The first messages to a server that has started: the session, and the marks of a recording."""
        header = self._hello()
        header["takes"] = self._mode == "live" and bool(self._takes.name)
        if self._marks:
            header["streams"].append(described(MARKS, SPEC))
            header["panels"] = shown_with(header["panels"])
        specs = [spec.to_json() for spec in self._specs.values()]
        return [encode({**header, "t0_ns": self._t0, "specs": specs, "modules": self._modules}), *self._marked()]

    def _hello(self) -> dict[str, Any]:
        header = hello(self._graph, outside=not is_loopback(self._address.host), mode=self._mode, t0_ns=self._t0)
        if self._avatar_asked:
            header["panels"] = with_avatar(header["panels"], self._specs)
        return header

    def answer(self, asked: dict[str, Any]) -> None:
        """What was asked for on the page, or by its server."""
        match asked.pop("do"):
            case "listen":
                self._port = asked["port"]
                self._listening.set()
                if not self._said:
                    self._said = True
                    say(f"{self.called}: {self.url(self._port)}", err=True)
            case "want":
                wanted, channel = set(asked["streams"]), self._handover.channel
                channel.seen = asked["seen"]
                channel.wanted[:] = [number in wanted for number in range(len(self._specs))]
            case what if what in self._steered:
                self._steered[what](**asked)
                log.info(MESSAGES[what], **asked)


def _pages(file: Path, since_s: float) -> list[Path]:
    """The HTML that an outlet has left: its file, or what is new in its folder."""
    if file.is_dir():
        return sorted(path for path in file.rglob("*.html") if path.stat().st_mtime >= since_s)
    return [file] if file.suffix == ".html" and file.is_file() else []


class FoxgloveLane(LivePage):
    """Serves a session to Foxglove until it is left."""

    server = "kinegraph.devices.page.foxglove"
    called = "foxglove"

    def __init__(self, graph: Graph, address: str = "", *, mode: str = "live") -> None:
        """Raises KinegraphError for an address that others reach, and where the SDK is not installed."""
        super().__init__(graph, address or f"127.0.0.1:{FOXGLOVE_PORT}", mode=mode)
        if not is_loopback(self._address.host):
            raise KinegraphError(
                f"--foxglove is served to this machine alone, not at {self._address.host}: its protocol has no token"
            )

    def refuse_missing(self) -> None:
        if importlib.util.find_spec("foxglove") is None:
            raise KinegraphError("--foxglove needs the Foxglove SDK: `pip install 'kinegraph[foxglove]'`")

    def url(self, port: int) -> str:
        return f"ws://{self._address.host}:{port}"


MESSAGES = {
    "tell": "set on the page",
    "mark": "annotated on the page",
    "take": "take on the page",
    "pace": "replay speed",
    "step": "replay goes a step",
    "seek": "replay goes to",
}
"""What the log says of what was asked for on the page."""
SHOWN = (
    *(
        "kind",
        "state",
        "samples",
        "rate_hz",
        "age_s",
        "p50_us",
        "p99_us",
        "queue",
        "queue_limit",
        "dropped",
        "late",
        "gaps",
    ),
    *("lost", "error", "findings", "openings", "bytes", "behind_s", "dropped_chunks", "worker", "cpu_pct"),
)
