"""A recording on the page: who looks at it, what each wants to see, and the marks that people make."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import structlog

from kinegraph.devices.page.hub import Looking, check_analysis
from kinegraph.devices.page.marks import MARKS, SPEC, shown_with
from kinegraph.devices.page.recorded.reading import RecordedViews
from kinegraph.devices.page.transfer import messages
from kinegraph.devices.page.transfer.catalogue import own_modules, recorded_panels, with_avatar
from kinegraph.devices.page.transfer.wire import Analyse, Asked, Look, Mark, encode
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import RecordedPage, load_page
from kinegraph.stream.recording import Recording

log = structlog.get_logger(__name__)


class Visitor(Looking):
    """A client of a recording: what it looks at now, and what has been made for it."""

    def __init__(self) -> None:
        super().__init__()
        self.look: Look | None = None
        self.outbox: list[bytes] = []
        self.busy = False
        self.task: asyncio.Task[None] | None = None


class RecordingHub(RecordedViews):
    """What the page's server shows of a recording.

    asks_avatar   an avatar is shown although no panel of the recording's graph is one
    """

    def __init__(self, recording: Recording, *, asks_avatar: bool = False) -> None:
        super().__init__(recording)
        self._asks_avatar = asks_avatar
        self._page = self._read_page()  # once, before anybody looks: it takes seconds where the text is made for that
        self._panels = self._arranged()
        session = recording.header.get("session")
        self._session = {str(k): str(v) for k, v in session.items()} if isinstance(session, dict) else {}
        self._new_marks: list[tuple[int, str]] = []
        self._keeping: asyncio.Task[None] | None = None
        self.clients: set[Looking] = set()

    def visitor(self) -> Looking:
        return Visitor()

    def greeting(self) -> bytes:
        spans = [
            [(s.first or 0) / NS - self.begin / NS, (s.last or 0) / NS - self.begin / NS, s.gaps] for s in self._streams
        ]
        return encode({
            "t": "hello", "v": 1, "name": self.recording.path.name, "mode": "recording", "t0_ms": self.begin / 1e6,
            "session": self._session,
            "streams": [*self.described.values()], "nodes": [], "edges": [], "values": [], "words": [],
            "panels": self._panels, "length_s": (self.end - self.begin) / NS, "spans": spans, "whole": self.whole,
            "gaps": [self._gaps(i) for i in range(len(self.names))],
            "moments": [self.moments.get(i) for i in range(len(self.names))],
        })  # fmt: skip

    def _arranged(self) -> list[dict[str, Any]]:
        specs = dict(zip(self.names, self.specs, strict=True))
        live = ("graph", "state", "log")
        panels = [panel for panel in recorded_panels(self._page, specs) if panel["kind"] not in live]
        panels = shown_with(with_avatar(panels, specs) if self._asks_avatar else panels)
        for panel in panels:
            panel["missing"] = [
                name for name in panel.get("missing", ()) if name not in self.recording.streams and name != MARKS
            ]
        return panels

    @cached_property
    def modules(self) -> dict[str, str]:
        return own_modules(self._page.options)

    def _read_page(self) -> RecordedPage:
        try:
            return load_page(str(self.recording.header["graph"]), self.recording.streams)
        except (KinegraphError, KeyError):
            return RecordedPage()

    def want(self) -> None:
        """Nothing: all is read when it is looked at."""

    def take(self, client: Looking, asked: Asked) -> None:
        """A look, or a mark. Raises ValueError for anything else."""
        if isinstance(asked, Mark) and asked.at is not None:
            self._mark(asked.text, self.begin + round(asked.at * NS))
            return
        if isinstance(asked, Analyse) and isinstance(client, Visitor):
            check_analysis(asked, self.specs)
            client.analyses[asked.stream] = asked
            self._begin_serving(client)
            return
        if (
            not isinstance(asked, Look)
            or not isinstance(client, Visitor)
            or any(not 0 <= s < len(self.specs) for s in asked.streams)
        ):
            raise ValueError("a recording can be looked at, not changed")
        client.look = asked
        self._begin_serving(client)

    def _begin_serving(self, client: Visitor) -> None:
        if not client.busy:
            client.busy = True
            client.task = asyncio.create_task(self._serve(client))

    def _mark(self, text: str, onset: int) -> None:
        """Keep a mark. Those that come while the file is being written are written together."""
        self._new_marks.append((onset, text))
        if self._keeping is None or self._keeping.done():
            self._keeping = asyncio.create_task(self._keep_marks())

    async def _keep_marks(self) -> None:
        """Write the marks that wait, and show them to all who look; if they cannot be kept, say why."""
        while self._new_marks:
            new, self._new_marks = self._new_marks, []
            try:
                await asyncio.to_thread(self.marks.add, new)
            except KinegraphError as error:
                log.warning("not marked", error=str(error))
                self.tell(encode({"t": "progress", "share": 0, "what": f"not marked: {error}"}))
            time, data = self.marks.read()
            self.tell(messages.events(self._marks_at, 0, SPEC, time, data, self.begin, fresh=True))

    async def close(self) -> None:
        """Wait until all marks are written."""
        if self._keeping:
            await self._keeping

    async def _serve(self, client: Visitor) -> None:
        """Make what the client looks at; of looks that came meanwhile only the last counts."""
        try:
            while client.look is not None or client.analyses:
                while client.analyses:
                    await self._make(client, partial(self.analysed, *client.analyses.popitem()))
                look, client.look = client.look, None
                if look is None:
                    continue
                for stream in look.streams:
                    await self._make(client, partial(self.seen, stream, look))
                client.outbox.append(encode({"t": "looked", "at": look.at}))
                client.news.set()
        finally:
            client.busy = False

    async def _make(self, client: Visitor, make: Callable[[], bytes | None]) -> None:
        """One message for a client; what cannot be shown is a line on its page."""
        try:
            made = await asyncio.to_thread(self.read, make)
        except KinegraphError as error:
            log.warning("cannot be shown", error=str(error))
            made = encode({"t": "progress", "share": 0, "what": f"cannot be shown: {error}"})
        if made:
            client.outbox.append(made)
            client.news.set()

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

    def metrics(self) -> dict[str, dict[str, Any]]:
        """For `/metrics`."""
        return {name: {"samples": s.samples, "gaps": s.gaps} for name, s in zip(self.names, self._streams, strict=True)}
