"""What the page's server knows, and who looks at it: streams as they come in, and clients that each take them at their own pace."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.page.transfer import messages
from kinegraph.devices.page.transfer.catalogue import always_kept, kind_of
from kinegraph.devices.page.transfer.downsample import Curve
from kinegraph.devices.page.transfer.history import History
from kinegraph.devices.page.transfer.spectra import analysed
from kinegraph.devices.page.transfer.wire import (
    Analyse,
    Asked,
    Look,
    Mark,
    RecordTake,
    See,
    Seek,
    SetPace,
    StepOn,
    Tell,
    encode,
)
from kinegraph.stream.chunk import NS, Chunk, StreamSpec

LOG_LINES = 200
CURVES = 8
"""This many curves are kept, of which the newest of each channel is shown."""


class Looking:
    """What one client looks at, and how far it has come.

    widths    per stream: ns for each point
    numbers   per stream: the next sample to be sent
    skipped   how often news came while it was still being sent earlier ones
    analyses  per stream: what it wants to be analysed, the last that it has asked for
    """

    def __init__(self) -> None:
        self.widths: dict[int, int] = {}
        self.numbers: dict[int, int] = {}
        self.news = asyncio.Event()
        self.skipped = 0
        self.state_sent = self.log_sent = self.pace_sent = 0
        self.greeted = True
        self.analyses: dict[int, Analyse] = {}

    def see(self, streams: dict[int, int]) -> None:
        """Look at these streams, and at no others; one with a new width is sent from its beginning."""
        self.numbers = {s: n for s, n in self.numbers.items() if self.widths.get(s) == streams.get(s, -1)}
        self.widths = streams


class Hub:
    """A live session, as far as the page's server has heard of it.

    ask   called with the streams in view, and with what clients ask of the session
    """

    def __init__(self, ask: Callable[[dict[str, Any]], None]) -> None:
        self._ask = ask
        self.hello: dict[str, Any] = {}
        self.specs: list[StreamSpec] = []
        self.histories: list[History] = []
        self.counts: list[int] = []
        self.clients: set[Looking] = set()
        self.modules: dict[str, str] = {}
        self.table: dict[str, Any] = {}
        self.edges: dict[str, float] = {}
        self.states = 0
        self.over = ""
        self.reports: list[str] = []
        self.dropped = 0
        self.starting = ""
        self._log: deque[dict[str, Any]] = deque(maxlen=LOG_LINES)
        self._lines = 0
        self._wanted: dict[str, Any] = {}
        self._made: dict[tuple[int, int, int], tuple[bytes, int] | None] = {}
        self._t0 = 0
        self._pace, self._paces = b"", 0

    # from the session ------------------------------------------------------------------------------------------------

    def receive(self, header: dict[str, Any], numbers: memoryview) -> None:
        """A message of the session's process."""
        match header["t"]:
            case "hello":
                self._begin(header)
            case "chunk":
                self._add(header, numbers)
            case "tick":
                self._made.clear()
                for client in self.clients:
                    client.skipped += client.news.is_set()
                    client.news.set()
            case "state":
                self.table, self.dropped, self.states = header["table"], header["dropped"], self.states + 1
                self.edges, self.starting = header.get("edges", {}), header.get("starting", "")
            case "pace":
                self._pace, self._paces = encode(header), self._paces + 1
            case "again":
                self._forget()
            case "log":
                self._log.append(header["line"])
                self._lines += 1
            case "over":
                self.over, self.reports = header["why"], header.get("reports", self.reports)
                self.states += 1

    def _begin(self, header: dict[str, Any]) -> None:
        self.specs = [StreamSpec.from_json(spec) for spec in header.pop("specs")]
        self.modules = header.pop("modules", {})
        self.hello, self._t0 = header, int(header.pop("t0_ns"))
        self.histories = [History(spec) for spec in self.specs]
        self.counts = [0] * len(self.specs)
        self.want()

    def _forget(self) -> None:
        """The replay begins again: clients are greeted again, and look at it from its beginning."""
        self.histories = [History(spec) for spec in self.specs]
        self._made.clear()
        for client in self.clients:
            client.numbers, client.greeted = {}, False

    def _add(self, header: dict[str, Any], numbers: memoryview) -> None:
        number, n = header["s"], header["n"]
        spec = self.specs[number]
        time = np.frombuffer(numbers, np.int64, n)
        data = np.frombuffer(numbers, spec.dtype, offset=8 * n).reshape(n, *spec.shape)
        self.histories[number].add(Chunk(time, data, header["until"], header["lost"]))

    # for clients -----------------------------------------------------------------------------------------------------

    def want(self) -> None:
        """Tell the session which streams somebody looks at."""
        kept = {i for i, spec in enumerate(self.specs) if always_kept(spec)}
        seen = {s for client in self.clients for s in client.widths if s < len(self.specs)}
        wanted = {"do": "want", "streams": sorted(kept | seen), "seen": bool(self.clients)}
        if wanted != self._wanted:
            self._wanted = wanted
            self._ask(wanted)

    def take(self, client: Looking, asked: Asked) -> None:
        """What a client asks for. Raises ValueError for what this session does not have."""
        match asked:
            case See(streams):
                if any(not 0 <= s < len(self.specs) for s in streams):
                    raise ValueError("there is no such stream")
                client.see(streams)
                self.want()
                client.news.set()
            case Analyse(stream):
                check_analysis(asked, self.specs)
                client.analyses[stream] = asked
                client.news.set()
            case Look():
                raise ValueError("only a recording can be looked into")
            case SetPace() | StepOn() | Seek() if self.hello["mode"] != "replay":
                raise ValueError("only a replay can be held or moved")
            case Mark() | RecordTake() | Tell() if self.hello["mode"] != "live":
                raise ValueError("a replay takes no input")
            case RecordTake() if not self.hello.get("takes"):
                raise ValueError("there is no avatar to record")
            case Tell(node) if node not in {value["node"] for value in self.hello["values"]}:
                raise ValueError("there is no such value")
            case _:
                self._ask(
                    {"do": asked.__struct_config__.tag, **{f: getattr(asked, f) for f in asked.__struct_fields__}}
                )

    def visitor(self) -> Looking:
        return Looking()

    def greeting(self) -> bytes:
        return encode(self.hello)

    def news_for(self, client: Looking) -> list[bytes]:
        """All that a client has not been sent yet."""
        found = [] if client.greeted else [self.greeting()]
        client.greeted = True
        if client.pace_sent < self._paces:
            client.pace_sent = self._paces
            found.append(self._pace)
        for stream, width in client.widths.items():
            number = client.numbers.get(stream, -1)
            key = (stream, width, number)
            if key not in self._made:
                self._made[key] = self._since(stream, width, number)
            if made := self._made[key]:
                found.append(made[0])
                client.numbers[stream] = made[1]
        while client.analyses:
            found.append(self._analysed(*client.analyses.popitem()))
        if client.log_sent < self._lines:
            lines = [*self._log][max(0, len(self._log) - (self._lines - client.log_sent)) :]
            client.log_sent = self._lines
            found.append(encode({"t": "log", "lines": lines}))
        if client.state_sent < self.states:
            client.state_sent = self.states
            more = {
                "clients": len(self.clients), "skipped": client.skipped, "dropped": self.dropped,
                "over": self.over, "reports": [Path(file).name for file in self.reports],
                "starting": self.starting,
            }  # fmt: skip
            found.append(encode({"t": "state", "table": self.table, "edges": self.edges, **more}))
        return found

    def _since(self, stream: int, width: int, number: int) -> tuple[bytes, int] | None:
        """A stream from a sample on (-1: from the oldest), as a message, and the number to go on from; None without news."""
        spec, history = self.specs[stream], self.histories[stream]
        fresh = number < 0
        if fresh:
            number = history.first
        if number >= history.end:
            return None
        kind = kind_of(spec)
        if kind == "signal":
            curve, then = history.curve(number, width)
            curve = _torn(curve) if not fresh and number < history.first else curve
            made = messages.signal(stream, curve, width, self._t0, fresh=fresh)
            return (made, then) if len(curve.time) else None
        if kind == "events":
            part = history.since(max(number, history.end - messages.MOST_ROWS))
            time, data = history.time[part], history.data[part]
            return messages.events(
                stream, history.end - len(time), spec, time, data, self._t0, fresh=fresh
            ), history.end
        stamp, sample = int(history.time[-1]), history.data[-1]
        if kind == "curves" and spec.dtype.kind == "f":
            sample = messages.completed(history.data[-CURVES:])
        return messages.newest(stream, spec, history.end, stamp, sample, self._t0), history.end

    def _analysed(self, stream: int, asked: Analyse) -> bytes:
        history = self.histories[stream]
        begin, end = (self._t0 + round(at * NS) for at in (asked.begin, asked.end))
        part = slice(*np.searchsorted(history.time, [begin, end]))
        return analysed(stream, self.specs[stream], asked, history.time[part], history.data[part], self._t0)

    @property
    def now_s(self) -> float:
        """How far the newest stream has come (s since the beginning)."""
        newest = [int(h.time[-1]) for h in self.histories if len(h.time)]
        return (max(newest) - self._t0) / NS if newest else 0.0


def check_analysis(asked: Analyse, specs: list[StreamSpec]) -> None:
    """Raises ValueError for a stream or a channel that cannot be analysed."""
    spec = specs[asked.stream] if 0 <= asked.stream < len(specs) else None
    if spec is None or kind_of(spec) != "signal" or not spec.rate_hz or not 0 <= asked.channel < spec.shape[0]:
        raise ValueError("there is no such signal")


def _torn(curve: Curve) -> Curve:
    """A curve behind samples that were forgotten before they could be sent: a gap before its first point."""
    if not len(curve.time):
        return curve
    low, high = (None if rows is None else np.insert(rows, 0, np.nan, axis=0) for rows in (curve.low, curve.high))
    assert low is not None
    return Curve(np.insert(curve.time, 0, curve.time[0]), low, high)
