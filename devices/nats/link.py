"""The connection to a NATS server: one thread for each server and account of a process, made again whenever it is lost.

The client library is asyncio's; `call` runs its coroutines on the link's thread and waits for them.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from typing import Any, TypeVar

import structlog

from kinegraph.devices.nats.messages import DATA, DATA_SUBJECTS, FACT_SUBJECTS, FACTS, PREFIX
from kinegraph.devices.nats.server import INSTALL, NatsServer
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.extras import optional

T = TypeVar("T")
ANSWER_S = 2.0
"""How long an answer is waited for."""
RETRY_S = 0.5
PING_S = 5
"""How often a silent connection is tried; one that does not answer twice is gone."""
WINDOW_S = 600.0
"""So long the server remembers ids of messages, by which it refuses a second copy."""

log = structlog.get_logger(__name__)


class Link:
    """A thread with a connection.

    error         why the server does not answer; "" where it does
    connections   how often it was connected
    """

    def __init__(self, server: NatsServer, name: str, inbox: str = "_INBOX") -> None:
        """`inbox` is where answers to requests come: an account that may not read others' answers has one of its own."""
        self._nats = optional("nats", "NATS", INSTALL, DeviceError)
        self.server, self._name, self._inbox = server, name, inbox
        self.error = ""
        self.connections = 0
        self._stopping = False
        self._loop = asyncio.new_event_loop()
        self._client = self._nats.NATS()
        self._subscriptions: list[tuple[str, Callable[[Any], Awaitable[None]]]] = []
        self._up = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"nats {name}", daemon=True)
        self._thread.start()

    @property
    def there(self) -> bool:
        return bool(self._client.is_connected)

    def wait(self, timeout_s: float) -> bool:
        """Wait until the server answers; whether it does."""
        return self._up.wait(timeout_s) and self.there

    def call(self, work: Coroutine[Any, Any, T], timeout_s: float = ANSWER_S) -> T:
        """Run a coroutine on the link's thread. Raises OSError where the server does not answer or refuses."""
        future = asyncio.run_coroutine_threadsafe(asyncio.wait_for(work, timeout_s), self._loop)
        try:
            return future.result(timeout_s + 1.0)
        except (TimeoutError, FutureTimeoutError, asyncio.CancelledError):
            future.cancel()
            raise OSError(f"the NATS server {self.server.url} does not answer") from None
        except self._nats.errors.Error as error:
            raise OSError(f"the NATS server {self.server.url}: {explained(error)}") from error

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine on the link's thread without waiting for it."""
        asyncio.run_coroutine_threadsafe(work, self._loop)

    @property
    def client(self) -> Any:
        """The library's client; for coroutines on the link's thread."""
        return self._client

    @property
    def stream(self) -> Any:
        """JetStream; for coroutines on the link's thread."""
        return self._client.jetstream(timeout=ANSWER_S)

    @property
    def error_kind(self) -> type[Exception]:
        """What the client library raises."""
        kind: type[Exception] = self._nats.errors.Error
        return kind

    def subscribe(self, subject: str, callback: Callable[[Any], Awaitable[None]]) -> None:
        """Receive a subject's messages on the link's thread, from now on and whenever the server is there."""

        async def add() -> None:
            self._subscriptions.append((subject, callback))
            if self._up.is_set():
                await self._client.subscribe(subject, cb=callback)

        self.start(add())

    def publish(self, subject: str, body: bytes) -> None:
        """Send without an answer; where the server is away it is dropped."""
        if self.there:
            self.start(self._publish(subject, body))

    async def _publish(self, subject: str, body: bytes) -> None:
        with suppress(self._nats.errors.Error, OSError):
            await self._client.publish(subject, body)

    def close(self) -> None:
        if self._stopping:
            return
        self._stopping = True

        async def farewell() -> None:
            with suppress(Exception):  # whatever is left of a connection is given up
                await asyncio.wait_for(self._client.flush(), 1.0) if self.there else None
            with suppress(Exception):
                await asyncio.wait_for(self._client.close(), 2.0)
            for task in asyncio.all_tasks(self._loop):
                if task is not asyncio.current_task():
                    task.cancel()
            await asyncio.sleep(0)
            self._loop.stop()

        self.start(farewell())
        self._thread.join(5.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        # such as an answer that comes when its caller has given up
        self._loop.set_exception_handler(lambda loop, context: log.debug("NATS link", what=context.get("message", "")))
        connecting = self._loop.create_task(self._connect())
        self._loop.run_forever()
        with suppress(asyncio.CancelledError):
            if connecting.done():
                connecting.exception()
        self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        self._loop.close()

    async def _connect(self) -> None:
        while not self._stopping:
            try:
                await self._client.connect(
                    **self.server.options, name=self._name, inbox_prefix=self._inbox.encode(), connect_timeout=2,
                    reconnect_time_wait=RETRY_S, max_reconnect_attempts=-1, ping_interval=PING_S, max_outstanding_pings=2,
                    error_cb=self._failed, disconnected_cb=self._gone, reconnected_cb=self._back,
                )  # fmt: skip
            except (TimeoutError, OSError, self._nats.errors.Error) as error:
                await self._failed(error)
                await asyncio.sleep(RETRY_S)
                continue
            for subject, callback in self._subscriptions:
                await self._client.subscribe(subject, cb=callback)
            await self._back()
            return

    async def _failed(self, error: Exception) -> None:
        text = explained(error)
        if text != self.error and not self._stopping:
            self.error = text
            log.warning("NATS server", url=self.server.url, error=text)

    async def _gone(self) -> None:
        self._up.clear()

    async def _back(self) -> None:
        if self.error:
            log.info("NATS server is there", url=self.server.url)
        self.error = ""
        self.connections += 1
        self._up.set()


_shared: dict[tuple[NatsServer, str], tuple[Link, int]] = {}
_sharing = threading.Lock()


def shared(server: NatsServer, name: str, inbox: str = "_INBOX") -> Link:
    """The process's connection to a server as `inbox`; give it back with `release`."""
    with _sharing:
        link, users = _shared.get((server, inbox), (None, 0))
        link = link or Link(server, name, inbox)
        _shared[server, inbox] = link, users + 1
        return link


def release(link: Link) -> None:
    """The caller needs the connection no more; with the last caller it is closed."""
    with _sharing:
        key = next((key for key, (one, _) in _shared.items() if one is link), None)
        if key is None:
            return
        users = _shared[key][1] - 1
        if users:
            _shared[key] = link, users
            return
        del _shared[key]
    link.close()


def explained(error: BaseException) -> str:
    return str(error).removeprefix("nats: ") or type(error).__name__


async def make_streams(link: Link, max_bytes: int = -1, age_s: float = 7 * 86400.0) -> None:
    """Make the server's two streams where they are missing; those that are there stay as they are."""
    from nats.js.api import StreamConfig
    from nats.js.errors import BadRequestError

    for config in (
        StreamConfig(
            name=DATA,
            subjects=[DATA_SUBJECTS],
            max_age=age_s,
            max_bytes=max_bytes,
            duplicate_window=min(WINDOW_S, age_s),
        ),
        StreamConfig(name=FACTS, subjects=[FACT_SUBJECTS], max_msgs_per_subject=1),
    ):
        with suppress(BadRequestError):  # it is there, with other limits
            await link.stream.add_stream(config)


async def fact(link: Link, name: str) -> bytes | None:
    """The last fact of that name ("bed1.facts.spec.emg"); None where there is none."""
    from nats.js.errors import NotFoundError

    try:
        found = await link.stream.get_last_msg(FACTS, f"{PREFIX}.{name}")
    except NotFoundError:
        return None
    return bytes(found.data or b"")
