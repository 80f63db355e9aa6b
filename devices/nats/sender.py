"""Sends a bed's messages to the server, one after the other and each once, and keeps them on the disk while the server is away."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping

import structlog

from kinegraph.devices.nats.link import ANSWER_S, Link, explained, make_streams
from kinegraph.devices.nats.messages import StreamMessage
from kinegraph.devices.nats.spool import Spool
from kinegraph.stream.chunk import FOREVER, NEVER

TICK_S = 0.02
PATIENCE_S = 2.0
"""What waits in memory for longer is brought to the disk."""
MAX_MEMORY_BYTES = 8 << 20
"""Or what is more."""
PAUSE_S = 0.5
"""After an attempt that failed."""
FAREWELL_S = 10.0
"""How long, at the end of a session, a server that takes messages is given to take the last."""

log = structlog.get_logger(__name__)


class MessageSender:
    """A thread. Messages go out in their order; the next one goes when the server has confirmed the one before.

    sent    how many messages the server has confirmed
    error   why the server takes no message now; "" where it does
    """

    def __init__(
        self,
        link: Link,
        spool: Spool,
        facts: Mapping[str, bytes],
        due: Callable[[], Iterable[StreamMessage]],
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        """`facts` are stored before the first message. `due` is asked for messages that are complete by age; `tick` is called often."""
        self._link, self._spool, self._facts, self._due, self._tick = link, spool, dict(facts), due, tick
        self._memory: deque[tuple[StreamMessage, float]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        """Of the spool and the memory."""
        self._wake, self._stop = threading.Event(), threading.Event()
        self._last = False
        self.saved: Callable[[], int] = lambda: FOREVER
        self.sent = 0
        self.error = ""
        self._thread = threading.Thread(target=self._run, name="nats sender", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def post(self, messages: Iterable[StreamMessage]) -> None:
        """Messages that follow those before."""
        with self._lock:
            for message in messages:
                self._memory.append((message, time.monotonic()))
                self._bytes += len(message.body)
                self._wake.set()
            if self._bytes > MAX_MEMORY_BYTES:
                self._to_disk()

    def keep(self) -> None:
        """Bring what waits to the disk, so that a checkpoint may count on it."""
        with self._lock:
            if self._memory:
                self._to_disk(sync=True)

    @property
    def waiting(self) -> int:
        with self._lock:
            return self._spool.waiting + len(self._memory)

    def fact(self, subject: str, body: bytes) -> None:
        """Store a further fact, or another value of one."""
        self._facts[subject] = body

    @property
    def introduced(self) -> bool:
        """Whether the server has the facts."""
        return not self._facts

    @property
    def spooled_bytes(self) -> int:
        return self._spool.size

    @property
    def dropped(self) -> int:
        return self._spool.dropped

    @property
    def disk_error(self) -> str:
        return self._spool.error

    def close(self) -> None:
        """Give the server a moment to take the last messages; the others stay on the disk for the next session."""
        self._last = True
        until, before, moved = time.monotonic() + FAREWELL_S, self.sent, time.monotonic()
        while self.waiting and self._link.there and time.monotonic() < until:
            self._wake.set()
            time.sleep(0.005)
            if self.sent != before:
                before, moved = self.sent, time.monotonic()
            elif time.monotonic() > moved + ANSWER_S:
                break
        self._stop.set()
        self._wake.set()
        self._thread.join(ANSWER_S + 2.0)
        self.keep()
        self._spool.close()

    def _run(self) -> None:
        pause_until = 0.0
        while not self._stop.is_set():
            self._wake.wait(TICK_S)
            self._wake.clear()
            self._tick()
            self.post(self._due())
            with self._lock:
                if self._memory and time.monotonic() - self._memory[0][1] > PATIENCE_S:
                    self._to_disk()
            while self._link.there and time.monotonic() >= pause_until and not self._stop.is_set():
                if not self._store_facts():
                    pause_until = time.monotonic() + PAUSE_S
                    break
                if (waits := self._next()) is None:
                    break
                number, message = waits
                if not self._send(message):
                    pause_until = time.monotonic() + PAUSE_S
                    break
                self._arrived(number)
                self.post(self._due())

    def _next(self) -> tuple[int, StreamMessage] | None:
        """The next message that may go; number 0: from memory."""
        saved = FOREVER if self._last else self.saved()
        with self._lock:
            first = self._spool.first()
            if first:
                return first if self._spool.held.get(first[0], NEVER) <= saved else None
            if self._memory and (message := self._memory[0][0]).handed <= saved:
                return 0, message
        return None

    def _arrived(self, number: int) -> None:
        with self._lock:
            self.sent += 1
            if number:
                self._spool.remove(number)
            elif self._memory:
                message, _ = self._memory.popleft()
                self._bytes -= len(message.body)

    def _to_disk(self, *, sync: bool = False) -> None:
        """What waits in memory goes behind what waits on the disk; where that is full, memory keeps it, and at last loses the oldest."""
        if self._spool.put([message for message, _ in self._memory], sync=sync):
            self._memory.clear()
            self._bytes = 0
            return
        while self._bytes > 2 * MAX_MEMORY_BYTES:
            message, _ = self._memory.popleft()
            self._bytes -= len(message.body)
            self._spool.dropped += 1

    def _store_facts(self) -> bool:
        for name in list(self._facts):
            if not self._published(name, self._facts[name], None):
                return False
            del self._facts[name]
        return True

    def _send(self, message: StreamMessage) -> bool:
        return self._published(message.subject, message.body, message.headers)

    def _published(self, subject: str, body: bytes, headers: dict[str, str] | None) -> bool:
        from nats.js.errors import NoStreamResponseError

        async def publish() -> None:
            await self._link.stream.publish(subject, body, headers=headers, timeout=ANSWER_S)

        try:
            self._link.call(publish(), 2 * ANSWER_S)
        except OSError as error:
            cause = error.__cause__
            self._complain(explained(cause or error))
            if isinstance(cause, NoStreamResponseError):
                self._make_streams()
            return False
        self._complain("")
        return True

    def _make_streams(self) -> None:
        """The server is new, or has lost its disk; an account that may not make streams waits for one that may."""
        try:
            self._link.call(make_streams(self._link))
        except OSError as error:
            self._complain(f"has no stream for messages, and none could be made ({error})")

    def _complain(self, error: str) -> None:
        if error != self.error:
            self.error = error
            if error:
                log.warning("NATS server takes no messages; they wait", why=error)
            else:
                log.info("NATS server takes messages")
