"""Who looks at a map of motion, what each is sent, and the process that answers queries."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path

import msgspec
import structlog

from kinegraph.devices.page.hub import Looking
from kinegraph.devices.page.map import picture
from kinegraph.devices.page.map.requests import Wanted, WantedCurve, WantedFrames, WantedNear
from kinegraph.devices.page.transfer.wire import encode
from kinegraph.stream.domain.pose_map import MotionIndex
from kinegraph.stream.system.subprocesses import child

log = structlog.get_logger(__name__)
READY = 0
"""The number of the first query; its answer shows that the process runs."""


class MapVisitor(Looking):
    """A client, and what has been made for it."""

    def __init__(self, first: list[bytes]) -> None:
        super().__init__()
        self.waiting = first
        self.news.set()

    def give(self, message: bytes) -> None:
        self.waiting.append(message)
        self.news.set()


class MapHub:
    """What the page's server shows of an index. `search` runs beside it."""

    def __init__(self, index: MotionIndex, path: Path, name: str) -> None:
        self.index, self._path = index, path
        self.clients: set[Looking] = set()
        self._opening, self._points, self._cells = (
            picture.opening(index, name),
            picture.points(index),
            picture.cells(index),
        )
        self._asked: dict[int, tuple[MapVisitor, float, WantedNear]] = {}
        self._numbers = count(READY + 1)
        self._process: asyncio.subprocess.Process | None = None
        self._answers = self._failed = False

    @property
    def modules(self) -> Mapping[str, str]:
        return {}

    def visitor(self) -> Looking:
        first = [self._points, self._cells]
        if self._answers or self._failed:
            first.append(self._state())
        return MapVisitor(first)

    def greeting(self) -> bytes:
        return self._opening

    def want(self) -> None:
        """Nothing: all is made when it is asked for."""

    def news_for(self, client: Looking) -> list[bytes]:
        assert isinstance(client, MapVisitor)
        made, client.waiting = client.waiting, []
        return made

    def take(self, client: Looking, asked: Wanted) -> None:
        """Raises ValueError for what is not there."""
        assert isinstance(client, MapVisitor)
        match asked:
            case WantedFrames(numbers, ask):
                client.give(picture.poses_at(self.index, numbers, ask))
            case WantedCurve(sequence, points):
                client.give(picture.curve_of(self.index, sequence, points))
            case WantedNear():
                self._ask(client, asked)

    def _ask(self, client: MapVisitor, asked: WantedNear) -> None:
        if self._failed or self._process is None or self._process.stdin is None:
            client.give(self._state())
            return
        number = next(self._numbers)
        self._asked[number] = client, asyncio.get_running_loop().time(), asked
        bits = sum(1 << m for m in set(asked.markers))
        line = f"{number} {asked.first} {asked.last} {asked.count} {asked.band_s} {bits}\n"
        self._process.stdin.write(line.encode())

    def _state(self) -> bytes:
        """Whether queries are answered."""
        return encode({"t": "search", "state": "failed" if self._failed else "ready"})

    async def search(self) -> None:
        """Run the graph that answers, in a process of its own, and pass on what it says; until cancelled."""
        self._process = process = await asyncio.create_subprocess_exec(
            *child("kinegraph.devices.page.map.searching", str(self._path.absolute())),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=1 << 22,
        )  # fmt: skip
        assert process.stdin and process.stdout
        try:
            process.stdin.write(f"{READY} 0 0 1 0 0\n".encode())
            async for line in process.stdout:
                self._hear(msgspec.json.decode(line))
            self._failed = True
            log.error("the process that answers queries has ended; poses can be looked at, nothing can be asked")
            self._send_all(self._state())
        finally:
            process.stdin.close()
            with suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), 5)
            if process.returncode is None:
                process.kill()

    def _hear(self, facts: dict[str, object]) -> None:
        if facts["query"] == READY:
            self._answers = True
            self._send_all(self._state())
            return
        known = self._asked.pop(int(str(facts["query"])), None)
        if known:
            client, since, asked = known
            ms = 1000 * (asyncio.get_running_loop().time() - since)
            what = {"first": asked.first, "last": asked.last}
            client.give(encode({"t": "near", **what, "ms": round(ms, 2), "found": facts["found"]}))

    def _send_all(self, message: bytes) -> None:
        for client in self.clients:
            assert isinstance(client, MapVisitor)
            client.give(message)
