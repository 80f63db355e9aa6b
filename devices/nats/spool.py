"""Messages that wait for the server, on the disk: a bounded queue that survives the process (SQLite)."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from kinegraph.devices.nats.messages import StreamMessage
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.atomic_file import PRIVATE, private_folder

TABLE = (
    "CREATE TABLE IF NOT EXISTS message "
    "(n INTEGER PRIMARY KEY AUTOINCREMENT, subject TEXT, id TEXT, session TEXT, spec TEXT, body BLOB)"
)
OVERHEAD = 200
"""Bytes of a message beside its body."""


class Spool:
    """Used by one thread at a time. What does not fit within `limit` bytes, or onto the disk, costs the oldest messages.

    size, waiting   bytes and messages that wait
    dropped         messages that had to go
    held            by number, of this process' messages, the newest arrival (ns) that its recording must have saved before they may go
    error           the disk's last error, while it refuses; else ""
    """

    def __init__(self, path: Path, limit: int) -> None:
        """Raises DeviceError where it cannot be written, or another process has it."""
        self._limit = limit
        try:
            private_folder(path.parent)
            self._lock = FileLock(path.with_suffix(".lock"))
            self._lock.acquire(blocking=False)
            os.close(os.open(path, os.O_RDWR | os.O_CREAT, PRIVATE))
            self._base = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=NORMAL")
            self._base.execute(TABLE)
            ((waiting, size),) = self._base.execute("SELECT count(*), total(length(body)) FROM message")
        except Timeout:
            raise DeviceError(f"{path}: another session sends from there; give each bed a name of its own") from None
        except (OSError, sqlite3.Error) as error:
            raise DeviceError(f"{path}: cannot be written ({error}); name another folder with `spool`") from None
        self.waiting = int(waiting)
        self.size = int(size) + OVERHEAD * self.waiting
        self.dropped = 0
        self.held: dict[int, int] = {}
        self.error = ""

    def put(self, messages: Sequence[StreamMessage], *, sync: bool = False) -> bool:
        """Append messages; `sync` brings them past every cache. Whether they are there: while the disk refuses they are not."""
        held = {}
        try:
            self._base.execute(f"PRAGMA synchronous={'FULL' if sync else 'NORMAL'}")
            with closing(self._base.cursor()) as cursor:
                cursor.execute("BEGIN")
                for m in messages:
                    cursor.execute(
                        "INSERT INTO message (subject, id, session, spec, body) VALUES (?, ?, ?, ?, ?)",
                        (m.subject, m.id, m.session, m.spec, m.body),
                    )
                    held[cursor.lastrowid or 0] = m.handed
                cursor.execute("COMMIT")
        except sqlite3.Error as error:
            self.error = str(error)
            with suppress(sqlite3.Error):
                self._base.execute("ROLLBACK")
            return False
        self.error = ""
        self.held |= held
        self.waiting += len(messages)
        self.size += sum(len(m.body) + OVERHEAD for m in messages)
        while self.size > self._limit and self.waiting > 1:
            self.dropped += 1
            self._remove("SELECT n, length(body) FROM message ORDER BY n LIMIT 1")
        return True

    def first(self) -> tuple[int, StreamMessage] | None:
        """The oldest message with its number; None where nothing waits."""
        if not self.waiting:
            return None
        try:
            row = self._base.execute("SELECT * FROM message ORDER BY n LIMIT 1").fetchone()
        except sqlite3.Error as error:
            self.error = str(error)
            return None
        return (row[0], StreamMessage(*row[1:])) if row else None

    def remove(self, number: int) -> None:
        """A message has arrived."""
        self._remove("SELECT n, length(body) FROM message WHERE n = ?", number)

    def _remove(self, which: str, *given: int) -> None:
        for number, size in self._base.execute(which, given).fetchall():
            with suppress(sqlite3.Error):  # a full disk: it is sent again one day, and the server refuses the copy
                self._base.execute("DELETE FROM message WHERE n = ?", (number,))
            self.held.pop(number, None)
            self.waiting -= 1
            self.size -= size + OVERHEAD

    def close(self) -> None:
        self._base.close()
        self._lock.release()
