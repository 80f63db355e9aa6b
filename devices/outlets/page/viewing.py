"""A recording on the page: what a client looks at is read from the file, what is seen from afar from pyramids made meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np
import structlog

from devices.outlets.page import messages
from devices.outlets.page.hub import Looking
from devices.outlets.page.marks import MARKS, SPEC, Marks, shown_with
from devices.outlets.page.pyramid import Pyramid
from devices.outlets.page.shown import default_panels, described, kind_of, panels_of
from devices.outlets.page.thin import as_rows, breaks, thinned
from devices.outlets.page.wire import Asked, Look, Mark, encode
from stream.chunk import NS, Array, StreamSpec, Times
from stream.errors import KinegraphError
from stream.graph import Graph
from stream.graph.load import load_text
from stream.recording import Recording
from stream.recording.recorded_stream import RecordedStream

EVENTS_BEFORE = 200
"""Events before what is looked at, for those that last into it."""
log = structlog.get_logger(__name__)

MOST_RAW = 400_000
"""More values than this are not read from the file for one look."""


class Visitor(Looking):
    """A client of a recording: what it looks at now, and what has been made for it."""

    def __init__(self) -> None:
        super().__init__()
        self.look: Look | None = None
        self.outbox: list[bytes] = []
        self.busy = False
        self.task: asyncio.Task[None] | None = None


class RecordingHub:
    """What the page's server shows of a recording."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.clients: set[Looking] = set()
        streams = {
            n: s
            for n, s in recording.streams.items()
            if s.kept != "outline" and s.first is not None and kind_of(s.spec) and n != MARKS
        }
        self.marks = Marks(recording.path)
        self._marks_at = len(streams)
        self.names, self._streams = [*streams, MARKS], [*streams.values(), RecordedStream(SPEC, "edge")]
        self.specs: list[StreamSpec] = [s.spec for s in self._streams]
        self.begin = min((s.first for s in self._streams if s.first is not None), default=0)
        self.end = max((s.last for s in self._streams if s.last is not None), default=0)
        self.pyramids: dict[int, Pyramid] = {}
        self._events: dict[int, tuple[Times, Array]] = {}
        self._progress = (0.0, "")
        self._reading = Lock()

    def visitor(self) -> Looking:
        return Visitor()

    def greeting(self) -> bytes:
        graph = self._graph()
        specs = dict(zip(self.names, self.specs, strict=True))
        inputs = {n.name: [str(edge) for edge in n.inputs.values()] for n in graph.nodes.values()} if graph else {}
        wide = ("graph", "state", "log")
        panels = (
            [p for p in panels_of(graph, specs) if p["kind"] not in wide] if graph else default_panels(specs, inputs)
        )
        panels = shown_with(panels)
        for panel in panels:
            panel["missing"] = [
                name for name in panel.get("missing", ()) if name not in self.recording.streams and name != MARKS
            ]
        spans = [
            [(s.first or 0) / NS - self.begin / NS, (s.last or 0) / NS - self.begin / NS, s.gaps] for s in self._streams
        ]
        return encode({
            "t": "hello", "v": 1, "name": self.recording.path.name, "mode": "recording", "t0_ms": self.begin / 1e6,
            "session": {str(k): str(v) for k, v in (self.recording.header.get("session") or {}).items()},
            "streams": [described(name, spec) for name, spec in specs.items()], "nodes": [], "edges": [], "values": [],
            "panels": panels, "length_s": (self.end - self.begin) / NS, "spans": spans,
            "gaps": [self._gaps(i) for i in range(len(self.names))],
        })  # fmt: skip

    def _graph(self) -> Graph | None:
        """The graph that made the recording, for the arrangement of its panels; None where it cannot be loaded here."""
        try:
            recorded = {name: s.spec for name, s in self.recording.streams.items()}
            return load_text(str(self.recording.header["graph"]), "recorded", recorded=recorded, trusted_only=True)
        except (KinegraphError, KeyError):
            return None

    def want(self) -> None:
        """Nothing: all is read when it is looked at."""

    def take(self, client: Looking, asked: Asked) -> None:
        """A look, or a mark. Raises ValueError for anything else."""
        if isinstance(asked, Mark) and asked.at is not None:
            self._mark(asked.text, self.begin + round(asked.at * NS))
            return
        if (
            not isinstance(asked, Look)
            or not isinstance(client, Visitor)
            or any(not 0 <= s < len(self.specs) for s in asked.streams)
        ):
            raise ValueError("a recording can be looked at, not changed")
        client.look = asked
        if not client.busy:
            client.busy = True
            client.task = asyncio.create_task(self._serve(client))

    def _mark(self, text: str, onset: int) -> None:
        """Keep a mark, and show it to all who look; one that cannot be kept is told of."""
        try:
            self.marks.add(onset, text)
        except KinegraphError as error:
            log.warning("not marked", error=str(error))
            self.tell(encode({"t": "progress", "share": 0, "what": f"not marked: {error}"}))
            return
        time, data = self.marks.read()
        self.tell(messages.events(self._marks_at, 0, SPEC, time, data, self.begin, fresh=True))

    async def _serve(self, client: Visitor) -> None:
        """Make what the client looks at; of looks that came meanwhile only the last counts."""
        try:
            while (look := client.look) is not None:
                client.look = None
                for stream in look.streams:
                    made = await asyncio.to_thread(self.seen, stream, look)
                    if made:
                        client.outbox.append(made)
                        client.news.set()
                client.outbox.append(encode({"t": "looked", "at": look.at}))
                client.news.set()
        except Exception:
            log.exception("what a client looks at cannot be shown")
        finally:
            client.busy = False

    def news_for(self, client: Looking) -> list[bytes]:
        assert isinstance(client, Visitor)
        made, client.outbox = client.outbox, []
        return made

    def tell(self, message: bytes) -> None:
        """To every client."""
        for client in self.clients:
            assert isinstance(client, Visitor)
            client.outbox.append(message)
            client.news.set()

    def seen(self, stream: int, look: Look) -> bytes | None:
        """One stream of a look, as a message."""
        begin, end, at = (self.begin + round(t * NS) for t in (look.begin, look.end, look.at))
        spec = self.specs[stream]
        with self._reading:
            if kind_of(spec) == "signal":
                return self._signal(stream, spec, begin, end, look.points)
            if kind_of(spec) == "events":
                return self._some_events(stream, spec, begin, max(end, at))
            return self._newest(stream, spec, at)

    def _signal(self, stream: int, spec: StreamSpec, begin: int, end: int, points: int) -> bytes | None:
        width = (end - begin) // points
        pyramid = self.pyramids.get(stream)
        if pyramid and width >= pyramid.width:
            curve = pyramid.curve(begin, end, width)
            return messages.signal(
                stream, curve, pyramid.width * max(1, round(width / pyramid.width)), self.begin, fresh=True
            )
        if (spec.rate_hz or 100.0) * (end - begin) / NS * spec.shape[0] > MOST_RAW and not pyramid:
            return None
        times, rows, torn = [np.empty(0, np.int64)], [np.empty((0, spec.shape[0]))], [np.zeros(0, np.bool_)]
        before = None
        for chunk in self.recording.chunks_from(self.names[stream], begin):
            if len(chunk.time) and chunk.time[0] > end:
                break
            torn.append(breaks(chunk.time, chunk.lost, before, spec.period_ns))
            before = int(chunk.time[-1]) if len(chunk.time) else before
            times.append(chunk.time)
            rows.append(as_rows(chunk.data).astype(np.float64))
        time, data, broken = np.concatenate(times), np.concatenate(rows), np.concatenate(torn)
        part = slice(*np.searchsorted(time, [begin, end]))
        count = part.stop - part.start
        width = 0 if count <= 2 * points else width
        return messages.signal(
            stream, thinned(time[part], data[part], broken[part], width), width, self.begin, fresh=True
        )

    def _some_events(self, stream: int, spec: StreamSpec, begin: int, end: int) -> bytes:
        if stream not in self._events and stream != self._marks_at:
            self._events[stream] = self.recording.read(self.names[stream])
        time, data = self.marks.read() if stream == self._marks_at else self._events[stream]
        last = int(np.searchsorted(time, end + 3600 * NS, side="right"))
        first = max(0, int(np.searchsorted(time, begin)) - EVENTS_BEFORE, last - messages.MOST_ROWS)
        return messages.events(stream, first, spec, time[first:last], data[first:last], self.begin, fresh=True)

    def _newest(self, stream: int, spec: StreamSpec, at: int) -> bytes | None:
        at = min(at, self._streams[stream].last or at)
        found: tuple[int, Array] | None = None
        for chunk in self.recording.chunks_from(self.names[stream], at):
            n = int(np.searchsorted(chunk.time, at, side="right"))
            if n:
                found = int(chunk.time[n - 1]), chunk.data[n - 1]
            if n < len(chunk.time):
                break
        return messages.newest(stream, spec, 0, *found, self.begin) if found else None

    def build(self, told: Callable[[bytes], None]) -> None:
        """Have a pyramid of every signal: the recorder's, or one made in a pass over all its samples. Tells of the progress and
        of the gaps that were found; called on a thread of its own."""
        signals = [
            i for i, spec in enumerate(self.specs) if kind_of(spec) == "signal" and self._streams[i].first is not None
        ]
        with Recording.open(self.recording.path) as own:
            for stream in signals:
                source = self._streams[stream]
                if overviews := own.overviews(self.names[stream]):
                    self.pyramids[stream] = Pyramid.seen(
                        self.specs[stream], overviews, source.first or 0, source.last or 0
                    )
                    told(encode({"t": "gaps", "s": stream, "gaps": self._gaps(stream)}))
        signals = [stream for stream in signals if stream not in self.pyramids]
        for done, stream in enumerate(signals):
            source = self._streams[stream]
            pyramid = Pyramid(self.specs[stream], source.first or 0, source.last or 0)
            shown = -1

            def progress(share: float, done: int = done) -> None:
                nonlocal shown
                if (percent := int(100 * (done + share) / len(signals))) > shown:
                    shown = percent
                    told(encode({"t": "progress", "share": percent / 100, "what": "reading"}))

            with Recording.open(self.recording.path) as own:
                pyramid.build(own.chunks(self.names[stream]), progress)
            self.pyramids[stream] = pyramid
            told(encode({"t": "gaps", "s": stream, "gaps": self._gaps(stream)}))
        told(encode({"t": "progress", "share": 1, "what": "reading"}))

    def _gaps(self, stream: int) -> list[list[float]]:
        pyramid = self.pyramids.get(stream)
        return [[(a - self.begin) / NS, (b - self.begin) / NS] for a, b in pyramid.gaps] if pyramid else []

    def metrics(self) -> dict[str, dict[str, Any]]:
        """For `/metrics`."""
        return {name: {"samples": s.samples, "gaps": s.gaps} for name, s in zip(self.names, self._streams, strict=True)}
