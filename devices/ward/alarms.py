"""Alarms: raised once, passed on to each receiver, kept until somebody acknowledges them (SQLite).

What a receiver can rely on: one trouble has one id as long as it lasts, also when the ward is started again. `attempt` is 1 the first time
an alarm is sent to a receiver. A higher one may have arrived before: the ward or the connection may have ended between the receiver's
answer and the note of it. A receiver that keeps the ids acts once.
"""

from __future__ import annotations

import json
import sqlite3
import threading
import urllib.request
import uuid
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import structlog

from kinegraph.devices.ward.beds import Trouble

TABLES = (
    "CREATE TABLE IF NOT EXISTS alarm (id TEXT PRIMARY KEY, bed TEXT, kind TEXT, level TEXT, text TEXT, raised REAL, over REAL, "
    "acknowledged REAL, by TEXT)",
    "CREATE TABLE IF NOT EXISTS passed (alarm TEXT, receiver TEXT, PRIMARY KEY (alarm, receiver))",
    "CREATE TABLE IF NOT EXISTS tried (alarm TEXT, receiver TEXT, times INTEGER, PRIMARY KEY (alarm, receiver))",
)
RAISING = ("alarm", "attention")
SENT = ("id", "attempt", "bed", "kind", "level", "text", "raised", "over", "acknowledged")
POST_S = 5.0
MAX_SHOWN = 200

log = structlog.get_logger(__name__)


class AlarmBook:
    """All alarms of a ward. Any thread may use it."""

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._base = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
        self._base.execute("PRAGMA journal_mode=WAL")
        for table in TABLES:
            self._base.execute(table)

    def update(self, bed: str, troubles: Iterable[Trouble], now_s: float) -> None:
        """What a bed's troubles are now: a new one is an alarm, one that is no more is over. It is one alarm as long as it lasts."""
        wanted = {one.kind: one for one in troubles if one.level in RAISING}
        with self._lock:
            known = {
                kind: id
                for id, kind in self._base.execute("SELECT id, kind FROM alarm WHERE bed = ? AND over IS NULL", (bed,))
            }
            for kind, one in wanted.items():
                if kind in known:
                    self._base.execute("UPDATE alarm SET text = ? WHERE id = ?", (one.text, known[kind]))
                else:
                    row = (uuid.uuid4().hex, bed, kind, one.level, one.text, now_s)
                    self._base.execute("INSERT INTO alarm VALUES (?, ?, ?, ?, ?, ?, NULL, NULL, '')", row)
            for kind, id in known.items():
                if kind not in wanted:
                    self._base.execute("UPDATE alarm SET over = ? WHERE id = ?", (now_s, id))

    def acknowledge(self, id: str, by: str, now_s: float) -> bool:
        """Somebody has seen it; whether there was such an alarm that was not acknowledged yet."""
        with self._lock:
            done = self._base.execute(
                "UPDATE alarm SET acknowledged = ?, by = ? WHERE id = ? AND acknowledged IS NULL", (now_s, by, id)
            )
            return done.rowcount > 0

    def open(self) -> list[dict[str, Any]]:
        """Alarms that are not acknowledged, the gravest and newest first."""
        return self._rows("WHERE acknowledged IS NULL ORDER BY level != 'alarm', raised DESC LIMIT ?", MAX_SHOWN)

    def due(self, receiver: str) -> list[dict[str, Any]]:
        """What a receiver has not got yet, in order."""
        return self._rows(
            "WHERE id NOT IN (SELECT alarm FROM passed WHERE receiver = ?) ORDER BY raised LIMIT ?",
            receiver,
            MAX_SHOWN,
        )

    def attempt(self, id: str, receiver: str) -> int:
        """Count one more attempt to send it, and return how many there were; on the disk before it is sent."""
        count = "INSERT INTO tried VALUES (?, ?, 1) ON CONFLICT DO UPDATE SET times = times + 1 RETURNING times"
        with self._lock:
            return int(self._base.execute(count, (id, receiver)).fetchone()[0])

    def passed(self, id: str, receiver: str) -> None:
        """A receiver has confirmed it."""
        with self._lock:
            self._base.execute("INSERT OR IGNORE INTO passed VALUES (?, ?)", (id, receiver))

    def _rows(self, where: str, *given: object) -> list[dict[str, Any]]:
        names = ("id", "bed", "kind", "level", "text", "raised", "over", "acknowledged", "by")
        with self._lock:
            return [
                dict(zip(names, row, strict=True)) for row in self._base.execute(f"SELECT * FROM alarm {where}", given)
            ]

    def close(self) -> None:
        with self._lock:
            self._base.close()


class Deliveries(threading.Thread):
    """Passes alarms on, in order, to each receiver until it has confirmed: tried again under the same id, as a further attempt.

    reachable  by receiver: whether there is a connection, if the receiver needs one; without it nothing is sent, and no attempt counted
    """

    def __init__(
        self,
        book: AlarmBook,
        receivers: dict[str, Callable[[dict[str, Any]], bool]],
        pause_s: float = 2.0,
        *,
        reachable: Mapping[str, Callable[[], bool]] = MappingProxyType({}),
    ) -> None:
        super().__init__(name="alarms", daemon=True)
        self._book, self._receivers, self._pause_s, self._reachable = book, receivers, pause_s, reachable
        self._stop = threading.Event()

    def run(self) -> None:
        while not self._stop.wait(self._pause_s):
            self.turn()

    def turn(self) -> None:
        """Pass on what is due; a receiver that refuses is asked again later, from the same alarm on."""
        for name, deliver in self._receivers.items():
            if name in self._reachable and not self._reachable[name]():
                continue
            for alarm in self._book.due(name):
                if not deliver({**alarm, "attempt": self._book.attempt(alarm["id"], name)}):
                    break
                self._book.passed(alarm["id"], name)

    def stop(self) -> None:
        self._stop.set()
        if self.is_alive():
            self.join(POST_S + 1)


def webhook(url: str) -> Callable[[dict[str, Any]], bool]:
    """Posts an alarm as JSON with its id as Idempotency-Key; an answer of 2xx confirms it."""

    def deliver(alarm: dict[str, Any]) -> bool:
        request = urllib.request.Request(
            url,
            _body(alarm).encode(),
            {"Content-Type": "application/json", "Idempotency-Key": alarm["id"]},
        )
        with suppress(OSError, ValueError), urllib.request.urlopen(request, timeout=POST_S) as answer:
            return bool(200 <= answer.status < 300)
        log.warning("the webhook does not take alarms", url=url.partition("?")[0])
        return False

    return deliver


def _body(alarm: dict[str, Any]) -> str:
    return json.dumps({name: alarm[name] for name in SENT})


class MqttAlarms:
    """Publishes alarms to PREFIX/alarm/BED with QoS 2, and takes acknowledgements: an id at PREFIX/acknowledge."""

    def __init__(self, broker: Any, acknowledge: Callable[[str], object], prefix: str = "kinegraph/ward") -> None:
        from kinegraph.devices.mqtt.link import BrokerConnection

        self._prefix, self._acknowledge = prefix, acknowledge
        self._waiting: dict[int, threading.Event] = {}
        self._lock = threading.Lock()
        self._done: set[int] = set()
        self._link = BrokerConnection(
            broker, f"kinegraph-ward-{uuid.uuid4().hex[:8]}", f"{prefix}/availability", [f"{prefix}/acknowledge"],
            joined=lambda: None, heard=self._heard, delivered=self._delivered,
        )  # fmt: skip
        self._link.start()

    def _heard(self, topic: str, text: str, retained: bool) -> None:
        if not retained:
            self._acknowledge(text.strip())

    def _delivered(self, number: int) -> None:
        with self._lock:
            self._done.add(number)
            if event := self._waiting.get(number):
                event.set()

    def is_connected(self) -> bool:
        return self._link.there

    def deliver(self, alarm: dict[str, Any]) -> bool:
        """Publish, and wait until the broker has confirmed."""
        event = threading.Event()
        number = self._link.say(f"{self._prefix}/alarm/{alarm['bed']}", _body(alarm), qos=2)
        if number is None:
            return False
        with self._lock:
            if number in self._done:
                self._done.discard(number)
                return True
            self._waiting[number] = event
        arrived = event.wait(POST_S)
        with self._lock:
            self._waiting.pop(number, None)
            self._done.discard(number)
        return arrived

    def stop(self) -> None:
        self._link.stop()
