"""What waits for the broker: the newest state of every topic, and messages, each of which arrives once and in order.

Nothing here knows a network. `flush` hands out what may be sent now; `delivered` and `remembered` say what has arrived.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import structlog

from kinegraph.stream.system.atomic_file import write_complete

MAX_MESSAGES = 6000
"""Two days of epochs. Beyond, the oldest are dropped and counted."""
IN_FLIGHT = 16
TOGETHER_S = 1.0

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class QueuedMessage:
    """One message that must arrive once. `number`: how the connection calls it; None: not handed out."""

    topic: str
    key: int
    text: str
    number: int | None = None


@dataclass(slots=True)
class MessageQueueState:
    """What survives a killed process.

    arrived   per topic the newest key that has arrived, as JSON
    messages   those that wait, a line each
    """

    session: str
    arrived: str = "{}"
    messages: str = ""


class MessageQueue:
    """Filled by one thread, emptied by another.

    say      hands a message to the connection: (topic, text, retain) -> its number, or None if there is no connection
    ledger   a file that remembers, over a power cut, what has arrived; None: the checkpoint and the broker's memory do
    """

    def __init__(
        self, state: MessageQueueState, say: Callable[[str, str, bool], int | None], ledger: Path | None = None
    ) -> None:
        self._session, self._say, self._ledger = state.session, say, ledger
        self._lock = threading.RLock()
        self._states: dict[str, str] = {}
        self._unsaid: dict[str, None] = {}
        """Topics with a state that was not handed out yet, in order."""
        self._messages: deque[QueuedMessage] = deque()
        self._posted: dict[str, int] = {}
        self._arrived: dict[str, int] = json.loads(state.arrived)
        self._ready = self._unwritten = False
        self._written_at = 0.0
        self.dropped = 0
        self._read_ledger()
        for line in state.messages.splitlines():
            topic, key, text = json.loads(line)
            self.post(topic, key, text)

    def state(self, topic: str, text: str) -> None:
        """The newest state of a topic."""
        with self._lock:
            self._states[topic] = text
            self._unsaid[topic] = None

    def post(self, topic: str, key: int, text: str) -> None:
        """Add a message, unless its key is not newer than what has arrived or waits on its topic: it was sent before."""
        with self._lock:
            if key <= self.newest(topic):
                return
            self._posted[topic] = key
            if len(self._messages) >= MAX_MESSAGES:
                self._messages.popleft()
                self.dropped += 1
                if self.dropped == 1:
                    log.error("no MQTT broker for too long: the oldest epochs are dropped (the night's log has them)")
            self._messages.append(QueuedMessage(topic, key, text))

    def newest(self, topic: str) -> int:
        """The newest key that has arrived or waits, or -1."""
        with self._lock:
            return max(self._posted.get(topic, -1), self._arrived.get(topic, -1))

    def open(self) -> None:
        """The connection stands, and the broker's retained messages are known: everything may be sent."""
        with self._lock:
            self._ready = True
            self._unsaid = dict.fromkeys(self._states)
            self.flush()

    def shut(self) -> None:
        """The connection is lost: what was on its way is sent again, unless the broker turns out to have it."""
        with self._lock:
            self._ready = False
            for message in self._messages:
                message.number = None

    def repeat(self) -> None:
        """Say every state again."""
        with self._lock:
            self._unsaid = dict.fromkeys(self._states)
            self.flush()

    def flush(self) -> None:
        """Hand out what may be sent now."""
        with self._lock:
            if not self._ready:
                return
            for topic in list(self._unsaid):
                if self._say(topic, self._states[topic], True) is None:
                    return
                del self._unsaid[topic]
            for message in islice(self._messages, IN_FLIGHT):
                if message.number is None:
                    message.number = self._say(message.topic, message.text, True)
                    if message.number is None:
                        return

    def delivered(self, number: int) -> None:
        """The broker has confirmed a message."""
        with self._lock:
            for message in self._messages:
                if message.number == number:
                    self._has_arrived(message.topic, message.key)
                    break
            else:
                return
            self.flush()
        self._write_ledger()

    def remembered(self, topic: str, text: str) -> None:
        """What the broker kept as a topic's last message; another session's says nothing about this one."""
        try:
            record = json.loads(text)
            if record["session"] != self._session:
                return
            key = int(record["key"])
        except (ValueError, KeyError, TypeError):
            return
        with self._lock:
            self._has_arrived(topic, key)
            self.flush()
        self._write_ledger()

    @property
    def empty(self) -> bool:
        with self._lock:
            return not self._messages and not self._unsaid

    @property
    def waiting(self) -> int:
        """How many messages have not arrived."""
        with self._lock:
            return len(self._messages)

    def keep(self) -> MessageQueueState:
        """What a checkpoint needs."""
        with self._lock:
            messages = "\n".join(json.dumps([x.topic, x.key, x.text]) for x in self._messages)
            return MessageQueueState(self._session, json.dumps(self._arrived), messages)

    def _has_arrived(self, topic: str, key: int) -> None:
        if key <= self._arrived.get(topic, -1):
            return
        self._arrived[topic] = key
        self._messages = deque(x for x in self._messages if x.topic != topic or x.key > key)
        self._unwritten = True

    def _read_ledger(self) -> None:
        try:
            record = json.loads(self._ledger.read_text(encoding="utf-8")) if self._ledger else {}
            if record.get("session") == self._session:
                for topic, key in record["arrived"].items():
                    self._arrived[topic] = max(int(key), self._arrived.get(topic, -1))
        except FileNotFoundError:
            return
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            log.warning("what was sent before cannot be read", path=str(self._ledger), error=str(error))

    def _write_ledger(self) -> None:
        """Outside the lock: a disk may be slow. While many messages are on their way, once a second is enough."""
        now = time.monotonic()
        if self._ledger is None or not self._unwritten or (self._messages and now < self._written_at + TOGETHER_S):
            return
        self._unwritten, self._written_at = False, now
        facts = {"session": self._session, "arrived": dict(self._arrived)}
        try:
            write_complete(self._ledger, json.dumps(facts))
        except OSError as error:
            log.warning("what was sent cannot be written down", path=str(self._ledger), error=error.strerror)
