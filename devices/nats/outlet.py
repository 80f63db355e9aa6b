"""Edges of a graph to another machine, over NATS JetStream."""

from __future__ import annotations

import json
import re
import shutil
import threading
import time
import uuid
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import structlog
from platformdirs import user_state_path

from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.messages import (
    GATHER_BEHIND_S,
    GATHER_S,
    MAX_SAMPLE_BYTES,
    Gathering,
    StreamMessage,
    digest_of,
    spec_text,
    subject,
)
from kinegraph.devices.nats.panels import panels_sent
from kinegraph.devices.nats.sender import MessageSender
from kinegraph.devices.nats.server import NatsServer, account_of, check_bed
from kinegraph.devices.nats.spool import Spool
from kinegraph.stream.chunk import FOREVER, NEVER, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.data.state import pack
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import ANY, Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.recording.format.layout import dump
from kinegraph.stream.recording.format.versions import release

if TYPE_CHECKING:
    from kinegraph.stream.graph import Graph
    from kinegraph.stream.system.clock import SessionClock

log = structlog.get_logger(__name__)

NIGHTS_S = 60.0
NIGHT = re.compile(r"[A-Za-z0-9_+-]+")
STATUS_S = 5.0
"""How often a bed reports how it is; and an event at once, but not oftener than `NEWS_S`."""
NEWS_S = 0.1
MAX_PROMPT = 20
"""Messages that may wait; with more, those to come are larger."""


@dataclass(slots=True)
class StreamOutletState:
    """By stream as JSON: the index after its last sample and up to when it is complete, as far as the spool has it."""

    session: str = ""
    sent: str = "{}"


@dataclass(slots=True)
class StreamNews:
    """What the bed's status names of a stream: the last sample's stamp, how many came and are missing, an event's fields."""

    last: int = 0
    samples: int = 0
    lost: int = 0
    until: int = 0
    row: dict[str, Any] = field(default_factory=dict)


class StreamOutletRuntime:
    """What belongs to a running outlet but not to its state."""

    def __init__(self, specs: Specs) -> None:
        self.specs = specs
        self.gatherings: dict[str, Gathering] = {}
        self.news = {port: StreamNews() for port in specs}
        self.lock = threading.Lock()
        self.now: Callable[[], int] = lambda: 0
        self.handed: Callable[[], int] = lambda: NEVER
        self.saved: Callable[[], int] = lambda: FOREVER
        self.link: links.Link | None = None
        self.sender: MessageSender | None = None
        self.facts: dict[str, Any] = {}
        self.panels: list[dict[str, Any]] = []
        self.bed = self.folder = ""
        self.reported_s = self.looked_s = 0.0
        self.began_s = time.monotonic()
        self.nights: set[str] = set()
        self.dropped = 0
        self.changed = True


@dataclass(frozen=True, slots=True)
class StreamOutlet(Outlet[StreamOutletState, StreamOutletRuntime]):
    """Publishes edges of the graph, so that `devices.nats.StreamInlet` continues them on another machine, sample for sample.

    Each stream goes out as a recording keeps it (stamps, samples, gaps, watermark), in messages of 100 ms (1 s while many wait) or 256 KiB.
    A message is sent once the bed's own recording has its input on the disk, and again until the server confirms it; while the server is
    away it waits in `spool`, which survives the process and is bounded by `spool_mb`: what is older is dropped, counted, and a gap at the
    other end. After a crash `--resume` sends what was not sent. Nothing waits for the network.

    It also reports every 5 s, and at each event, how the bed is: what `kinegraph ward` shows, with this graph's panels. No fact of the
    session leaves the bed but those that `identifiers` names, as it names them: {subject: S07}; text fields of events with these names are
    replaced, too.
    """

    inputs = {ANY: Input()}
    durable: ClassVar[bool] = True
    in_order: ClassVar[bool] = False

    account: str = param(
        "", help="a server.yaml of `kinegraph ward add`, which names bed and server, so that one graph serves all beds"
    )
    bed: str = param(
        "", help="what this machine is called at the centre, without `account`; both empty: nothing is sent"
    )
    server: NatsServer = param(NatsServer(), help="the NATS server and the account there")
    spool: str = param("", help="the folder of what waits for the server; left out: one in the user's folder of states")
    spool_mb: float = param(1000.0, above=0.0, help="how much may wait there")
    identifiers: dict[str, str] | None = param(
        None, help="facts of the session and text fields of events, with what replaces them"
    )
    nights: str = param("", help="the folder of a night's log: a night that is over goes to the centre, too")
    pulse: str = param("", help="the stream that shows that the sensor works; left out: the first one with a rate")

    def open(self, specs: Specs) -> Specs:
        if self.bed:
            check_bed(self.bed)
            self.server.check()
        elif self.account and Path(self.account).exists():
            account_of(Path(self.account))
        for port, spec in specs.items():
            if spec.sample_bytes > MAX_SAMPLE_BYTES:
                raise InputError(port, spec.describe(), f"samples of at most {MAX_SAMPLE_BYTES >> 10} KiB")
            if not re.fullmatch(r"[A-Za-z0-9_.-]+", port):
                raise InputError(port, f"called {port!r}", "letters, digits, dots, - and _ in its name")
        if self.pulse and self.pulse not in specs:
            raise ParameterError("pulse", self.pulse, f"one of {', '.join(specs)}")
        self.set_state(StreamOutletState(), StreamOutletRuntime(dict(specs)))
        return {}

    @property
    def undelivered(self) -> str:
        dropped = self.runtime.dropped
        return (
            f"the spool of {self.runtime.bed} was full: {dropped} messages are missing at the centre" if dropped else ""
        )

    def keep_time(self, clock: SessionClock) -> None:
        self.runtime.now = clock.now

    def follow_disk(self, handed: Callable[[], int], saved: Callable[[], int]) -> None:
        self.runtime.handed, self.runtime.saved = handed, saved

    def meet(self, graph: Graph) -> None:
        self.runtime.folder = graph.recorded_in
        self.runtime.facts = {
            "graph": graph.name,
            "digest": digest_of(graph.text),
            "version": release(),
            "recording": Path(graph.recorded_in).name if graph.recorded_in else "",
            "session": {name: text for name, text in (self.identifiers or {}).items() if name in graph.session},
        }
        if self.bed or self.account:
            self.runtime.panels = panels_sent(graph, self, self.runtime.specs)

    def begin(self) -> None:
        runtime, state = self.runtime, self.state
        if not self.bed and not self.account:
            return
        runtime.bed, server = account_of(Path(self.account)) if self.account else (self.bed, self.server)
        runtime.began_s = time.monotonic()
        state.session = state.session or uuid.uuid4().hex[:16]
        sent = json.loads(state.sent)
        for port, spec in runtime.specs.items():
            samples, until = sent.get(port, (0, NEVER))
            runtime.gatherings[port] = Gathering(
                spec, subject(runtime.bed, "data", port), state.session, samples, until
            )
        folder = Path(self.spool) if self.spool else user_state_path("kinegraph") / "spool"
        name = digest_of(" ".join(runtime.specs))
        spool = Spool(folder / f"{runtime.bed}.{name}.sqlite", round(self.spool_mb * 1e6))
        runtime.link = links.shared(server, f"kinegraph {runtime.bed}", f"_INBOX_{runtime.bed}")
        runtime.link.subscribe(subject(runtime.bed, "ask", "clock"), self._answer_clock)
        facts = {
            subject(runtime.bed, "facts", f"spec.{port}"): spec_text(spec).encode()
            for port, spec in runtime.specs.items()
        }
        facts[subject(runtime.bed, "facts", "panels")] = dump(runtime.panels)
        runtime.sender = MessageSender(runtime.link, spool, facts, self._due, self._report)
        runtime.sender.saved = runtime.saved
        runtime.sender.start()

    def process(self, port: str, chunk: Chunk) -> None:
        runtime = self.runtime
        if runtime.sender is None:
            return
        self._note(port, chunk)
        chunk = self._replaced(chunk)
        with runtime.lock:
            messages = list(runtime.gatherings[port].add(chunk, runtime.now(), runtime.handed()))
        if messages:
            runtime.sender.post(messages)

    def _due(self) -> Iterator[StreamMessage]:
        """Messages that are complete by age; on the sender's thread."""
        runtime = self.runtime
        behind = runtime.sender is not None and runtime.sender.waiting > MAX_PROMPT
        gather_s = GATHER_BEHIND_S if behind else GATHER_S
        with runtime.lock:
            now = runtime.now()
            return iter([m for one in runtime.gatherings.values() for m in one.due(now, gather_s=gather_s)])

    def _rest(self) -> None:
        """What is gathered is a message now."""
        runtime = self.runtime
        assert runtime.sender
        with runtime.lock:
            messages = [m for one in runtime.gatherings.values() for m in one.due(0, last=True)]
            runtime.sender.post(messages)

    def snapshot(self) -> dict[str, Array]:
        runtime = self.runtime
        if runtime.sender is not None:
            self._rest()
            runtime.sender.keep()
            self.state.sent = json.dumps({port: (one.samples, one.until) for port, one in runtime.gatherings.items()})
        return pack(self.state)

    def close(self) -> None:
        runtime = self.runtime
        if runtime.sender is None or runtime.link is None:
            return
        self._rest()
        runtime.sender.close()
        runtime.dropped = runtime.sender.dropped
        self._report(last=True)
        links.release(runtime.link)
        runtime.sender = runtime.link = None

    # what the bed reports ------------------------------------------------------------------------------------------------

    def _note(self, port: str, chunk: Chunk) -> None:
        runtime = self.runtime
        news, spec, n = runtime.news[port], runtime.specs[port], len(chunk)
        news.lost += max(chunk.lost, 0)
        news.samples += n
        news.until = chunk.until if chunk.until < FOREVER else news.until
        if n:
            news.last = int(chunk.time[-1])
            if spec.is_event:
                news.row = _row(self._replaced(chunk).data[-1], spec)
                runtime.changed = True

    def _replaced(self, chunk: Chunk) -> Chunk:
        """The chunk with the identifiers in its texts replaced."""
        given = self.identifiers or {}
        names = [f for f in chunk.data.dtype.names or () if f in given and chunk.data.dtype[f].kind in "US"]
        if not names or not len(chunk):
            return chunk
        data = chunk.data.copy()
        for name in names:
            data[name] = given[name]
        return Chunk(chunk.time, data, chunk.until, chunk.lost)

    def _report(self, *, last: bool = False) -> None:
        """Publish how the bed is, if it is time; on the sender's thread."""
        runtime, now = self.runtime, time.monotonic()
        link, sender = runtime.link, runtime.sender
        if self.nights and sender is not None and now - runtime.looked_s > NIGHTS_S:
            runtime.looked_s = now
            self._send_nights(sender)
        if link is None or sender is None or not link.there:
            return
        if not last and now - runtime.reported_s < (NEWS_S if runtime.changed else STATUS_S):
            return
        runtime.reported_s, runtime.changed = now, False
        try:
            free = shutil.disk_usage(runtime.folder or ".").free
        except OSError:
            free = -1
        facts = {
            **runtime.facts,
            "bed": self.runtime.bed,
            "now": runtime.now(),
            "age_s": round(now - runtime.began_s, 1),
            "ended": last,
            "free_bytes": free,
            "waiting": 0 if last else sender.waiting,
            "spool_bytes": 0 if last else sender.spooled_bytes,
            "spool_dropped": sender.dropped,
            "disk_error": sender.disk_error,
            "pulse": self.pulse or next((port for port, spec in runtime.specs.items() if spec.rate_hz), ""),
            "streams": {
                port: {"last": n.last, "until": n.until, "samples": n.samples, "lost": n.lost, "row": n.row}
                for port, n in runtime.news.items()
            },
        }
        link.publish(subject(self.runtime.bed, "status"), dump(facts))

    def _send_nights(self, sender: MessageSender) -> None:
        """Nights of the log that are over, each once for each session."""
        from kinegraph.devices.reports.night import archive

        for folder, facts in archive.nights(Path(self.nights)):
            if facts.closed and folder.name not in self.runtime.nights and NIGHT.fullmatch(folder.name):
                self.runtime.nights.add(folder.name)
                try:
                    body = self._night(folder)
                except (OSError, ValueError, KeyError) as error:
                    log.warning("a night cannot be sent", night=folder.name, error=str(error))
                    continue
                if len(body) <= MAX_SAMPLE_BYTES:
                    sender.fact(subject(self.runtime.bed, "facts", f"night.{folder.name}"), body)

    def _night(self, folder: Path) -> bytes:
        """A night's log, with its identifiers replaced."""
        from kinegraph.devices.reports.night import archive

        given = self.identifiers or {}
        texts = {name: (folder / name).read_text(encoding="utf-8") for name in (archive.FACTS, archive.EPOCHS)}
        kept = json.loads(texts[archive.FACTS])
        kept["session"] = {name: text for name, text in given.items() if name in kept["session"]}
        kept["sleeper"], kept["settings"] = given.get("sleeper", ""), []
        return zlib.compress(json.dumps({**texts, archive.FACTS: json.dumps(kept)}).encode())

    async def _answer_clock(self, request: Any) -> None:
        await request.respond(json.dumps({"now": self.runtime.now()}).encode())


def _row(row: Any, spec: StreamSpec) -> dict[str, Any]:
    """An event's plain fields."""
    found = {}
    for name in spec.channels:
        value = row[name]
        if isinstance(value, np.generic) and value.dtype.kind in "iufbU":
            plain = value.item()
            found[name] = None if isinstance(plain, float) and not np.isfinite(plain) else plain
    return found
