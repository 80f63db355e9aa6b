"""Messages of one subject from the server's stream, in order from a given one, each once, whatever becomes of connection and server."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from kinegraph.devices.nats.link import ANSWER_S, Link, explained
from kinegraph.devices.nats.messages import DATA, SESSION, SPEC

HEARTBEAT_S = 1.0
SILENT_S = 3.5
"""Without even a heartbeat for so long, the server has forgotten the subscription."""
MAX_WAITING_BYTES = 16 << 20
"""With this much waiting here, the server is asked to wait."""
FORGET_S = 60.0
"""So long the server keeps a subscription of a process that is gone."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message with its number in the server's stream."""

    sequence: int
    session: str
    spec: str
    body: bytes


class Subscription:
    """The server pushes; what arrives waits here. A message that is missing between two makes it begin again after the one before.

    lost_disk   how often the server's stream was made again, and so was read from its beginning
    error       why nothing can be read now
    """

    def __init__(self, link: Link, subject: str, after: int, created: str = "") -> None:
        """`after` is the number of the last message that was read, in the stream made at `created` ("": whichever it is)."""
        self._link, self._subject, self._after, self.created = link, subject, after, created
        self._waiting: deque[Received] = deque()
        self._bytes = 0
        self._news = threading.Event()
        self._round = self._connection = 0
        self._expected = 1
        self._alive = 0.0
        self._inbox: Any = None
        self._consumer = ""
        self._from_now = False
        self.lost_disk = 0
        self.error = ""

    def from_now(self) -> None:
        """Leave out what the stream holds already."""
        self._from_now = True

    def take(self, timeout_s: float) -> list[Received]:
        """What has arrived, in order; waits for the first."""
        silent = time.monotonic() - self._alive > SILENT_S
        if not self._waiting and (silent or (self._link.there and self._connection != self._link.connections)):
            self._begin()
        if not self._waiting:
            self._news.wait(timeout_s)
        self._news.clear()
        taken = []
        while self._waiting:
            one = self._waiting.popleft()
            self._bytes -= len(one.body)
            taken.append(one)
        return taken

    def close(self) -> None:
        self._round += 1
        if self._inbox is not None and self._link.there:
            with suppress(OSError):
                self._link.call(self._end())

    def _begin(self) -> None:
        """Subscribe after the last message; where that cannot be, it is tried again later."""
        self._alive = time.monotonic()
        if not self._link.there:
            self.error = self._link.error or "the server does not answer"
            return
        self._round += 1
        self._connection = self._link.connections
        try:
            self._link.call(self._subscribe(self._round), 3 * ANSWER_S)
            self.error = ""
        except OSError as error:
            self.error = explained(error.__cause__ or error)

    async def _subscribe(self, round: int) -> None:
        from nats.js.api import AckPolicy, ConsumerConfig, DeliverPolicy

        await self._end()
        client, stream = self._link.client, self._link.stream
        info = await stream.stream_info(DATA)
        created, last = str(info.created), info.state.last_seq
        if (self.created and created != self.created) or last < self._after:
            self._after = 0
            self.lost_disk += 1
        self.created = created
        if self._from_now:
            self._after, self._from_now = max(self._after, last), False
        self._expected = 1
        inbox = client.new_inbox()

        async def received(message: Any) -> None:
            await self._received(message, round)

        self._inbox = await client.subscribe(inbox, cb=received, pending_bytes_limit=4 * MAX_WAITING_BYTES)
        made = await stream.add_consumer(
            DATA,
            ConsumerConfig(
                deliver_subject=inbox, filter_subject=self._subject, ack_policy=AckPolicy.NONE, max_deliver=1,
                deliver_policy=DeliverPolicy.BY_START_SEQUENCE, opt_start_seq=self._after + 1, flow_control=True,
                idle_heartbeat=HEARTBEAT_S, mem_storage=True, num_replicas=1, inactive_threshold=FORGET_S,
            ),
        )  # fmt: skip
        self._consumer = made.name

    async def _end(self) -> None:
        inbox, self._inbox, consumer, self._consumer = self._inbox, None, self._consumer, ""
        with suppress(Exception):  # it may be gone with the server
            if inbox is not None:
                await inbox.unsubscribe()
            if consumer:
                await self._link.stream.delete_consumer(DATA, consumer)

    async def _received(self, message: Any, round: int) -> None:
        """On the link's thread."""
        import asyncio

        if round != self._round:
            return
        self._alive = time.monotonic()
        headers = message.headers or {}
        if headers.get("Status") == "100":
            while self._bytes > MAX_WAITING_BYTES and round == self._round:
                await asyncio.sleep(0.01)
            if message.reply:  # flow control: the server goes on when it is answered
                await message.respond(b"")
            elif stalled := headers.get("Nats-Consumer-Stalled"):
                await self._link.client.publish(stalled, b"")
            return
        sequence = message.metadata.sequence
        if sequence.consumer != self._expected:  # one between is missing
            self._round += 1
            self._alive = 0.0
            self._news.set()
            return
        self._expected += 1
        self._after = sequence.stream
        self._waiting.append(Received(self._after, headers.get(SESSION, ""), headers.get(SPEC, ""), message.data))
        self._bytes += len(message.data)
        self._news.set()
