"""The connection to an MQTT broker: made in the background, made again whenever it is lost, never waited for by anyone."""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import structlog
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from kinegraph.devices.mqtt.bounded_client import BoundedClient
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
KEEPALIVE_S = 30
MAX_NEWS = 1000
"""This many messages may wait to be looked at; beyond, they are dropped and counted."""
PROBE_S = 1.5
"""So long a broker may take to accept a connection, before a session."""
FAREWELL_S = 2.0
"""How long the last messages are given to reach the broker."""
ONLINE, OFFLINE = "online", "offline"

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Broker:
    """Where the broker is and how it is spoken to.

    password_file   a file with the password in its first line, so that the graph, copied into every recording, has no password
    tls             encrypted, the broker's certificate checked by the system's authorities, or by `ca_file`
    """

    host: str = "localhost"
    port: int = param(1883, least=1, most=65535)
    username: str = ""
    password_file: str = ""
    tls: bool = False
    ca_file: str = ""

    def check(self) -> None:
        """Raises ParameterError for what cannot be."""
        if not self.host:
            raise ParameterError("broker", self.host, "a host's name or address")
        if set("@/ ") & set(self.host):
            accepts = (
                "a host's name or address alone; the user's name is `username`, the password comes from `password_file`"
            )
            raise _untold("host", accepts)
        if not 1 <= self.port <= 65535:
            raise ParameterError("broker", self.port, "a port from 1 to 65535")
        if self.password_file and not Path(self.password_file).is_file():
            raise _untold("password_file", "a file that exists, and that holds the password")
        if self.ca_file and not Path(self.ca_file).is_file():
            raise ParameterError("broker", self.ca_file, "a file that exists")
        for name in (self.password_file, self.ca_file):
            if name and not os.access(name, os.R_OK):
                raise ParameterError("broker", name, "a file that the user who runs kinegraph may read")
        if self.password_file and not self.username:
            raise ParameterError("broker", self.password_file, "given together with a username")

    def missing(self) -> str:
        """What to report where no broker answers; "" where one does, or where there is to be no connection."""
        if not self.host:
            return ""
        try:
            socket.create_connection((self.host, self.port), PROBE_S).close()
        except OSError as error:
            why = error.strerror or str(error)
            return f"no MQTT broker at {self.host}:{self.port} ({why}); start one, or name another: `broker: {{host: ...}}`"
        return ""

    @property
    def password(self) -> str | None:
        if not self.password_file:
            return None
        return next(iter(Path(self.password_file).read_text(encoding="utf-8").splitlines()), "")


def _untold(parameter: str, accepts: str) -> ParameterError:
    """The error about a value that may be, or hold, a password, and so is not shown."""
    error = ParameterError("broker", None, accepts)
    error.args = (f"broker.{parameter} is not shown here, as it may hold a password; it must be {accepts}",)
    return error


class BrokerConnection:
    """A thread that keeps a connection to the broker. The caller repeats what it was given without a connection.

    greeting       topic that says `online` (retained) while we are there; the broker itself says `offline` when we vanish
    subscriptions  topics that are heard
    joined         called when the connection stands and the subscriptions are in force
    heard          called with (topic, text, retained) of every message
    delivered      called with the number of a message that the broker has confirmed
    left           called when the connection is lost

    All four are called in the link's own thread, never in that of the MQTT library, which holds locks of its own while it calls.
    """

    def __init__(
        self,
        broker: Broker,
        client_id: str,
        greeting: str,
        subscriptions: Sequence[str],
        *,
        joined: Callable[[], None],
        heard: Callable[[str, str, bool], None] = lambda topic, text, retained: None,
        delivered: Callable[[int], None] = lambda number: None,
        left: Callable[[], None] = lambda: None,
    ) -> None:
        self._broker, self._id, self._greeting, self._subscriptions = broker, client_id, greeting, list(subscriptions)
        self._joined, self._heard, self._delivered, self._left = joined, heard, delivered, left
        self._client: BoundedClient | None = None
        self._there = False
        self._stopping = threading.Event()
        self._news: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        """What the library has called us for; None: the connection is over."""
        self._trouble = ""
        self._refused = False
        """Whether the broker has refused this attempt: that the connection then ends is no second trouble."""
        self.dropped = 0
        """Messages that were too many."""
        self.failures = 0
        """Attempts that did not bring a connection."""
        self.pause_s = FIRST_PAUSE_S
        """How long is waited before the next attempt."""
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"mqtt {client_id}", daemon=True)

    @property
    def there(self) -> bool:
        """Whether the connection stands."""
        return self._there

    def start(self) -> None:
        self._thread.start()

    def say(self, topic: str, text: str, *, retain: bool = False, qos: int = 1) -> int | None:
        """Hand a message to the connection; its number, or None if there is no connection. Never waits for the network."""
        client = self._client
        if client is None or not self._there:
            return None
        result = client.publish(topic, text, qos=qos, retain=retain)
        return result.mid if result.rc == 0 else None

    def hasten(self) -> None:
        """Make the next attempt at once."""
        self._wake.set()

    def stop(self) -> None:
        """Say good-bye, give the last messages a moment, and end the thread."""
        client = self._client
        self._stopping.set()
        self._wake.set()
        if client is not None and self._there:
            with contextlib.suppress(RuntimeError, ValueError):
                client.publish(self._greeting, OFFLINE, qos=1, retain=True).wait_for_publish(FAREWELL_S)
            client.disconnect()
        self._news.put(None)
        if self._thread.is_alive():
            self._thread.join(FAREWELL_S)

    def _work(self) -> None:
        while not self._stopping.is_set():
            self._attempt()
            self._wake.wait(self.pause_s)
            self._wake.clear()
            self.pause_s = min(2 * self.pause_s, LONGEST_PAUSE_S)

    def _attempt(self) -> None:
        """Connect, and serve the connection until it is lost."""
        self._news, self._refused, stood, client = SimpleQueue(), False, False, None
        try:
            client = self._client = self._made()
            client.connect(self._broker.host, self._broker.port, KEEPALIVE_S)
            client.loop_start()
            while (news := self._news.get()) is not None and not self._stopping.is_set():
                news()
                stood = stood or self._there
        except (OSError, ValueError) as error:
            self._complain(str(error))
        except Exception as error:
            log.error("MQTT connection failed", error=f"{type(error).__name__}: {error}", exc_info=True)
        finally:
            self._gone()
            if client is not None:
                client.loop_stop()
        if stood:
            self.pause_s = FIRST_PAUSE_S
        else:
            self.failures += 1

    def _made(self) -> BoundedClient:
        client = BoundedClient(CallbackAPIVersion.VERSION2, self._id, reconnect_on_failure=False)
        broker, tell = self._broker, self._news.put
        if broker.username:
            client.username_pw_set(broker.username, broker.password)
        if broker.tls or broker.ca_file:
            client.tls_set(ca_certs=broker.ca_file or None, cert_reqs=ssl.CERT_REQUIRED)
        client.will_set(self._greeting, OFFLINE, qos=1, retain=True)
        client.on_connect = lambda c, d, flags, reason, p: tell(lambda: self._connected(client, reason))
        client.on_subscribe = lambda c, d, number, reasons, p: tell(lambda: self._subscribed(client, reasons))
        client.on_message = lambda c, d, message: self._take(message)
        client.on_publish = lambda c, d, number, reason, p: tell(lambda: self._delivered(number))
        client.on_disconnect = lambda c, d, flags, reason, p: tell(lambda: self._disconnected(reason)) or tell(None)
        return client

    def _connected(self, client: Client, reason: Any) -> None:
        if reason.is_failure:
            self._refused = True
            broker = self._broker
            given = (
                f"username {broker.username!r} with its password_file"
                if broker.username
                else "a connection without a username"
            )
            self._complain(f"it refuses {given}: {reason}")
            self._news.put(None)
        elif self._subscriptions:
            client.subscribe([(topic, 1) for topic in self._subscriptions])
        else:
            self._welcome(client)

    def _subscribed(self, client: Client, reasons: Any) -> None:
        refused = [topic for topic, reason in zip(self._subscriptions, reasons, strict=False) if reason.is_failure]
        if refused:
            log.warning("MQTT broker refuses a subscription", topics=refused)
        self._welcome(client)

    def _welcome(self, client: Client) -> None:
        if self._trouble:
            log.info("MQTT broker is there", host=self._broker.host, port=self._broker.port)
            self._trouble = ""
        self._there = True
        client.publish(self._greeting, ONLINE, qos=1, retain=True)
        self._joined()

    def _take(self, message: MQTTMessage) -> None:
        """A message, in the library's thread: kept for ours where there is room for it."""
        if self._news.qsize() < MAX_NEWS:
            self._news.put(lambda: self._message(message))
            return
        self.dropped += 1
        if self.dropped == 1:
            log.warning(
                "MQTT messages arrive faster than they are processed; some are dropped", topic=message.topic[:200]
            )

    def _message(self, message: MQTTMessage) -> None:
        self._heard(message.topic, message.payload.decode("utf-8", "replace"), bool(message.retain))

    def _disconnected(self, reason: Any) -> None:
        if not self._stopping.is_set() and not self._refused:
            self._complain(str(reason))

    def _gone(self) -> None:
        if self._there:
            self._there = False
            self._left()

    def _complain(self, why: str) -> None:
        if why != self._trouble:
            self._trouble = why
            broker = self._broker
            log.warning("no MQTT broker; retrying until it answers", host=broker.host, port=broker.port, why=why)
