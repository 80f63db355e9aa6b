"""A live session's way to its page: streams that somebody looks at go to the server's process, and what people ask for comes back.

The graph's own thread puts chunks into a bounded channel, and some 30 times a second writes those that have come together to the server, in
one system call that never waits: no other thread is woken. Pictures, the engine's state and the log are written by a thread of the lane's
own. Where the server is slow, or gone, views are dropped, and samples never wait. A server that ends is started again.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, MutableMapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import structlog

from devices.outlets.page.access import is_loopback, new_token
from devices.outlets.page.channel import TICK_S, UNSEEN_TICK_S, PageChannel, Portion, message
from devices.outlets.page.marks import MARKS, SPEC, Marks, shown_with
from devices.outlets.page.pipe import PipeMessage, ServerPipe
from devices.outlets.page.serving import FILES, built, tls_context
from devices.outlets.page.shown import described, hello, is_newest_only, offered, own_modules, with_avatar
from devices.outlets.page.wire import OPTIONS, encode
from stream.child import child
from stream.chunk import NS
from stream.engine.status import Table
from stream.errors import KinegraphError
from stream.graph import Graph
from stream.plain import plain, say

if TYPE_CHECKING:
    from stream.engine.pipeline import Pipeline
    from stream.engine.replay import Replay
    from stream.engine.session import Session

SEEN_TICK_S = 0.1
"""How soon what is left is handed over, where no further chunk comes; what comes regularly is handed over by those that bring it."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
LAST_S = 1.0
"""How long a server that has no room is waited for when a session ends."""
NICE = 10
"""How far the server's priority is below the session's, from its first instant: to load it costs a second of a processor."""
START_S = 20.0
"""How long a server is waited for when a session begins."""
DEFAULT_PORT = 7790
AVATAR = Path(__file__).with_name("avatar.vrm")
"""A mannequin: `python -m tests.mannequin` makes it."""
MOST_AVATAR = 128 << 20
MOST_LINES = 200
"""Lines of the log that wait for the server; a page shows as many."""
ALSO = ("kind", "time", "level")
"""What a recorded line of the log has beside its facts."""
FOXGLOVE_PORT = 8765

log = structlog.get_logger(__name__)


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


class LivePage:
    """Shows a session in browsers until it is left.

    server   the module that is run to serve it
    called   what people call it
    """

    server: ClassVar[str] = "devices.outlets.page.server"
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
    ) -> None:
        """`address` is HOST, HOST:PORT or :PORT; `avatar` a VRM file that the graph's avatar gives way to. Raises KinegraphError where the
        page cannot be served."""
        self._graph, self._mode = graph, mode
        self._address = parsed(address, certificate, key)
        self._address.check()
        self.refuse_missing()
        self._avatar = checked_avatar(avatar or graph.page.avatar)
        self._avatar_asked = avatar is not None
        self._modules = own_modules(graph)
        self._specs = offered(graph, outside=not is_loopback(self._address.host))
        self._channel = PageChannel([is_newest_only(spec) for spec in self._specs.values()])
        self._steered: dict[str, Callable[..., None]] = {}
        self._pending: list[bytes] = []
        self._state = self._pace = b""
        self._length_s = 0.0
        self._marks: Marks | None = None
        self._writing = threading.Lock()
        self._over, self._listening = threading.Event(), threading.Event()
        self._port, self._t0 = self._address.port, time.time_ns()
        self._said = False
        self._pipeline: Pipeline | None = None
        self._samples: dict[str, int] = {}
        self._counted_s = 0.0
        self._threads = [threading.Thread(target=self._run, name="page", daemon=True)]

    def url(self, port: int) -> str:
        """The address that is printed."""
        return self._address.url(port)

    def refuse_missing(self) -> None:
        """Raises KinegraphError where what it is served by is not there."""
        refuse_unbuilt()

    # the session's side ----------------------------------------------------------------------------------------------

    def attach(self, session: Session) -> None:
        """Observe what is to be shown; called before the session runs."""
        self._t0 = session.clock.now()
        self.observe(session.pipeline)
        self._steered = {"mark": lambda text, at: session.mark(text, self._onset(at)), "tell": session.tell}

    def replays(self, replay: Replay) -> None:
        """Observe a replay; one that begins again is shown from its beginning."""
        recording, pace = replay.recording, replay.pace
        self._t0 = recording.begin_of_inputs
        if not self._length_s:
            self._marks = Marks(recording.path)
            self._specs = {**self._specs, MARKS: SPEC}
            self._channel = PageChannel([is_newest_only(spec) for spec in self._specs.values()])
            self._pending = [
                _line(
                    e["time"] / NS,
                    str(e.get("level", "info")),
                    str(e["kind"]),
                    {k: v for k, v in e.items() if k not in ALSO},
                )
                for e in recording.log[-MOST_LINES:]
            ]
        else:
            self._channel.forget()
            self._channel.announce(encode({"t": "again"}), *self._marked())
        self.observe(replay.pipeline)
        replay.view = self
        self._length_s = max(replay.length_s, 1e-9)
        if pace:
            self._steered = {"pace": pace.go, "step": pace.step, "seek": pace.seek}
            pace.report_to(lambda at, speed: self._set_pace(at, speed))

    def _set_pace(self, at: float, speed: float) -> None:
        self._pace = encode({"t": "pace", "at": at, "speed": speed, "length": self._length_s})

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
                pipeline.edges[name].observers.append(self._channel.observer(number))

    def _onset(self, at: float | None) -> int | None:
        return None if at is None else self._t0 + round(at * NS)

    def update(self, table: Table) -> None:
        """Take the newest metrics."""
        told = {name: {key: value for key, value in row.items() if key in SHOWN} for name, row in table.items()}
        self._state = encode({"t": "state", "table": told, "dropped": self._channel.dropped, "edges": self._rates()})

    def _rates(self) -> dict[str, float]:
        """Samples per second of every edge since this was asked last."""
        edges = self._pipeline.edges if self._pipeline else {}
        counts = {name: edge.samples for name, edge in edges.items()}
        before, self._samples = self._samples, counts
        then, self._counted_s = self._counted_s, time.monotonic()
        lasted = self._counted_s - then
        return {name: round((count - before[name]) / lasted, 2) for name, count in counts.items() if name in before}

    def __enter__(self) -> Self:
        self._before = structlog.get_config()["processors"]
        structlog.configure(processors=[self._note, *self._before])
        self._threads[0].start()
        self._listening.wait(START_S)
        return self

    def __exit__(self, *_: object) -> None:
        structlog.configure(processors=self._before)
        self._over.set()
        self._threads[0].join(5)

    def _note(self, _logger: Any, level: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        """A line of the log, on its way to wherever it goes."""
        facts = {key: value for key, value in event.items() if key not in ("event", "exc_info")}
        line = _line(time.time(), level, str(event.get("event", "")), facts)
        with self._writing:
            self._pending = [*self._pending[1 - MOST_LINES :], line]
        return event

    # the lane's thread -----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause = FIRST_PAUSE_S
        while not self._over.is_set():
            began = time.monotonic()
            try:
                self._serve()
            except (OSError, ValueError) as error:
                log.debug("the page's server has ended", error=str(error))
            if self._over.is_set():
                break
            pause = FIRST_PAUSE_S if time.monotonic() - began > LONGEST_PAUSE_S else min(2 * pause, LONGEST_PAUSE_S)
            log.warning(f"the {self.called}'s server has ended; it is started again", in_s=pause)
            self._over.wait(pause)

    def _serve(self) -> None:
        """One server, from its start until it or the session ends."""
        options = json.dumps(asdict(self._address) | {"port": self._port, "avatar": str(self._avatar)})
        given = {**os.environ, OPTIONS: options}  # which, unlike arguments, no other user sees: the token is among them
        with subprocess.Popen(
            child(self.server), env=given, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        ) as server:
            assert server.stdin
            _yielding(server.pid)
            pipe = ServerPipe(server.stdin.fileno())
            try:
                pipe.write([[self._greeting()], *([told] for told in self._marked())])
                self._channel.lead_to(pipe)
                self._hand_over(pipe)
                threading.Thread(target=self._hear, args=(server,), name="page answers", daemon=True).start()
                while not self._over.wait(self._tick_s) and server.poll() is None:
                    self._hand_over(pipe)
                if self._over.is_set():
                    self._hand_over_last(pipe)
            finally:
                self._channel.lead_to(None)
                with suppress(OSError):
                    server.stdin.close()
                _end(server)

    @property
    def _tick_s(self) -> float:
        """How soon this thread has something to hand over: a picture, where a replay stands, or what others have left."""
        channel = self._channel
        if not channel.seen:
            return UNSEEN_TICK_S
        return TICK_S if channel.pictures_wanted or channel.is_left or self._mode != "live" else SEEN_TICK_S

    def _greeting(self) -> bytes:
        greeting = hello(self._graph, outside=not is_loopback(self._address.host), mode=self._mode, t0_ns=self._t0)
        if self._avatar_asked:
            greeting["panels"] = with_avatar(greeting["panels"], self._specs)
        if self._marks:
            greeting["streams"].append(described(MARKS, SPEC))
            greeting["panels"] = shown_with(greeting["panels"])
        specs = [spec.to_json() for spec in self._specs.values()]
        return encode({**greeting, "t0_ns": self._t0, "specs": specs, "modules": self._modules})

    def _hand_over(self, pipe: ServerPipe) -> None:
        """All that waits; as soon as there is room, where there is none."""
        with self._writing:
            pending, self._pending = self._pending, []
        (state, self._state), (pace, self._pace) = (self._state, b""), (self._pace, b"")
        told: list[PipeMessage] = [[part] for part in (*pending, state, pace) if part]
        told += map(message, self._channel.pictures())
        while not self._channel.hand_over(*told) and self._channel.is_led and not self._over.is_set():
            pipe.wait(SEEN_TICK_S)

    def _hand_over_last(self, pipe: ServerPipe) -> None:
        """What is left at the end, and that this is the end."""
        end = time.monotonic() + LAST_S
        self._hand_over(pipe)
        last = [encode({"t": "over", "why": "the session has ended"})]
        while not self._channel.hand_over(last) and self._channel.is_led and time.monotonic() < end:
            pipe.wait(SEEN_TICK_S)
        while not self._channel.hand_over() and self._channel.is_led and time.monotonic() < end:
            pipe.wait(SEEN_TICK_S)

    def _hear(self, server: subprocess.Popen[bytes]) -> None:
        """What the server asks for, line by line."""
        assert server.stdout
        for line in server.stdout:
            try:
                asked = json.loads(line)
                self._answer(asked)
            except KinegraphError as error:
                log.warning("not understood", asked_on_the_page=asked, error=str(error))
            except Exception as error:  # noqa: BLE001 - the session does not end because of its page
                log.warning("the page asked for something that cannot be", error=str(error))

    def _answer(self, asked: dict[str, Any]) -> None:
        match asked.pop("do"):
            case "listen":
                self._port = asked["port"]
                self._listening.set()
                if not self._said:
                    self._said = True
                    say(f"{self.called}: {self.url(self._port)}", err=True)
            case "want":
                wanted, self._channel.seen = set(asked["streams"]), asked["seen"]
                self._channel.wanted[:] = [number in wanted for number in range(len(self._specs))]
            case what if what in self._steered:
                self._steered[what](**asked)
                log.info(SAID[what], **asked)


class FoxgloveLane(LivePage):
    """Serves a session to Foxglove until it is left."""

    server = "devices.outlets.page.foxglove"
    called = "foxglove"

    def __init__(self, graph: Graph, address: str = "", *, mode: str = "live") -> None:
        """Raises KinegraphError for an address that others reach, and where the SDK is not installed."""
        super().__init__(graph, address or f"127.0.0.1:{FOXGLOVE_PORT}", mode=mode)
        if not is_loopback(self._address.host):
            raise KinegraphError(
                f"--foxglove is served to this machine alone, not at {self._address.host}: its protocol knows no token"
            )

    def refuse_missing(self) -> None:
        if importlib.util.find_spec("foxglove") is None:
            raise KinegraphError("--foxglove needs the Foxglove SDK: `pip install 'kinegraph[foxglove]'`")

    def url(self, port: int) -> str:
        return f"ws://{self._address.host}:{port}"


SAID = {
    "tell": "set on the page",
    "mark": "annotated on the page",
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
    *("lost", "error", "openings", "bytes", "behind_s", "dropped_chunks", "worker", "cpu_pct"),
)


def _line(at: float, level: str, event: str, facts: Mapping[str, Any]) -> bytes:
    """A line of the log as the server takes it; `at`: Unix time (s)."""
    told = ", ".join(f"{key} {value}" for key, value in facts.items())
    text = plain(f"{event}{': ' if told else ''}{told}")[:500]
    return encode({"t": "log", "line": {"at": at, "level": level, "text": text}})


def refuse_unbuilt() -> None:
    """Raises KinegraphError where the page was not built."""
    try:
        [built(name) for name, _ in FILES.values()]
    except FileNotFoundError:
        raise KinegraphError(
            "the page was not built: `python -m pip install -e .` builds it (from the npm registry)"
        ) from None


def checked_avatar(path: Path | None) -> Path:
    """The avatar that a page shows: this file, or the one that comes with it. Raises KinegraphError for one that cannot be shown."""
    if path is None:
        return AVATAR
    from devices.files.vrm_read import read_vrm  # loads scipy

    if not path.is_file():
        raise KinegraphError(f"avatar {path}: there is no such file; it must be a VRM file")
    if path.stat().st_size > MOST_AVATAR:
        raise KinegraphError(f"avatar {path}: {path.stat().st_size >> 20} MB; at most {MOST_AVATAR >> 20}")
    read_vrm(path)
    return path.resolve()


def parsed(address: str, certificate: str = "", key: str = "") -> Address:
    """HOST, HOST:PORT or :PORT. Raises KinegraphError for what is none of these."""
    host, colon, port = address.rpartition(":") if not address.endswith("]") else (address, "", "")
    host = (host if colon else address).strip("[]") or "127.0.0.1"
    if colon and not (port.isdigit() and int(port) < 65536):
        raise KinegraphError(f"--page-at {address}: HOST, HOST:PORT or :PORT, with a port from 0 to 65535")
    token = "" if is_loopback(host) else new_token()
    return Address(host, int(port) if colon else DEFAULT_PORT, certificate, key, token)


def _yielding(pid: int) -> None:
    """Views wait where the machine is busy; samples do not."""
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, pid, NICE)


def _end(server: subprocess.Popen[bytes]) -> None:
    try:
        server.wait(3)
    except subprocess.TimeoutExpired:
        server.kill()
