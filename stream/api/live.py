"""A session that runs while a program or a notebook goes on, and hands over what comes out of it."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

from kinegraph.stream.chunk import Chunk
from kinegraph.stream.cli.commands.logs import to_logging
from kinegraph.stream.cli.commands.run import simulated
from kinegraph.stream.data.series import Series
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.graph import Graph
from kinegraph.stream.recording.format.paths import refuse_taken_folder
from kinegraph.stream.text.short_names import whole_name

WAITING = 1000
"""Chunks that wait for the program; when there are more, the oldest are dropped, and counted. The session never waits."""
LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class Piece:
    """What an edge gave: `series` holds the chunk's samples; `dropped` chunks were not taken in time before it."""

    edge: str
    series: Series
    dropped: int = 0


class LiveSession:
    """A running session as a context manager and an iterator, plain or asynchronous.

    with kinegraph.live("treadmill_emg", ["cycles.closed"]) as session:
        for piece in session: ...                     # or: async for piece in session: ...
        session.mark("start"); session.set("envelope", "10")
    session.outcome.exit_code

    It is recorded into `folder`, if one is given. Outlets (files, networks, the terminal) are silent but those that are named. Leaving the
    block ends it. What its operators raise is raised there.
    """

    def __init__(
        self,
        graph: Graph,
        edges: Iterable[str],
        folder: Path | None = None,
        duration_s: float = 0.0,
        *,
        outlets: Iterable[str] = (),
        simulate: bool = False,
    ) -> None:
        """Raises KinegraphError where an edge is not there, or the folder is taken."""
        if folder is not None:
            refuse_taken_folder(folder)
        self.outcome: Outcome | None = None
        self._error: BaseException | None = None
        self._pieces: queue.Queue[tuple[str, Chunk]] = queue.Queue(WAITING)
        self._dropped = 0
        self._simulated = simulated(graph) if simulate else nullcontext()
        to_logging()
        speaking = (
            graph.outlets if "all" in (asked := {*outlets}) else {whole_name(name, graph.outlets) for name in asked}
        )
        for name in speaking - graph.outlets:
            raise KinegraphError(f"there is no outlet {name!r}; {nearest(name, graph.outlets)}")
        self._session = Session(graph, folder, duration_s=duration_s, speaking=speaking)
        self._specs = {name: edge.spec for name, edge in self._session.pipeline.edges.items()}
        for name in (whole_name(edge, self._specs) for edge in edges):
            if name not in self._specs:
                raise KinegraphError(f"there is no output {name!r}; {nearest(name, self._specs)}")
            self._session.pipeline.edges[name].observers.append(partial(self._take, name))
        self._thread = threading.Thread(target=self._run, name="live session", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._session.stop()
        self._thread.join()
        if error[0] is None:
            self._raise()

    def mark(self, text: str) -> None:
        """Annotate this moment."""
        self._session.mark(text)

    def set(self, node: str, value: str) -> None:
        """Give a node a value, as `name=value` typed into the terminal does."""
        self._session.tell(node, value)

    def stop(self) -> None:
        """End the session; what has been given so far can still be taken."""
        self._session.stop()

    def __iter__(self) -> Iterator[Piece]:
        while (piece := self._next()) is not None:
            yield piece

    async def __aiter__(self) -> AsyncIterator[Piece]:
        while (piece := await asyncio.to_thread(self._next)) is not None:
            yield piece

    def _next(self) -> Piece | None:
        """The next chunk, waited for; None when the session has ended and all are taken."""
        while True:
            with suppress(queue.Empty):
                name, chunk = self._pieces.get(timeout=LOOK_S)
                dropped, self._dropped = self._dropped, 0
                return Piece(name, Series.of_chunks(name, self._specs[name], [chunk]), dropped)
            if not self._thread.is_alive() and self._pieces.empty():
                self._raise()
                return None

    def _take(self, name: str, chunk: Chunk) -> None:
        """On the graph's thread: never waits."""
        if not len(chunk):
            return None
        while True:
            try:
                return self._pieces.put_nowait((name, chunk))
            except queue.Full:
                with suppress(queue.Empty):
                    self._pieces.get_nowait()
                    self._dropped += 1

    def _run(self) -> None:
        try:
            with self._simulated:
                self.outcome = self._session.run()
            self._error = self.outcome.error
        except BaseException as error:  # noqa: BLE001 - raised where the session is read
            self._error = error

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error
