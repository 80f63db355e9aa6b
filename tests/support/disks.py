"""A disk that takes only so much, at the level of the calls by which the recorder writes."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Sequence

import pytest


class Disk:
    """`os.write` and `os.writev` as a disk with so much room gives them.

    room      bytes that it still takes
    error     what it says without room (errno)
    delay_s   how long a call takes
    """

    def __init__(self, room: float = float("inf"), error: int = errno.ENOSPC, delay_s: float = 0.0) -> None:
        self.room, self.error, self.delay_s = room, error, delay_s
        self.real = os.write

    def write(self, file: int, data: bytes | memoryview) -> int:
        time.sleep(self.delay_s)
        if self.room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        n = self.real(file, data[: int(min(len(data), self.room))])
        self.room -= n
        return n

    def writev(self, file: int, pieces: Sequence[bytes | memoryview]) -> int:
        return self.write(file, b"".join(pieces))

    def put_in(self, monkeypatch: pytest.MonkeyPatch) -> Disk:
        """From now on, for the rest of the test, this process writes to it."""
        monkeypatch.setattr(os, "write", self.write)
        monkeypatch.setattr(os, "writev", self.writev)
        return self
