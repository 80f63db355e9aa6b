"""The session's end of the pipe to its page's server: a writer never waits, and what finds no room at once goes first the next time."""

from __future__ import annotations

import os
import select
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import islice
from typing import TypeAlias

import numpy as np

from kinegraph.devices.page.transfer.wire import LENGTH
from kinegraph.stream.chunk import Array

PipeMessage: TypeAlias = "Sequence[bytes | Array]"
"""Its parts, one behind the other; arrays are contiguous."""
MAX_BUFFERS = 512
"""In one system call; Linux and macOS take 1024."""
CAPACITY = 1 << 20
"""Bytes that the system is asked to hold (Linux's default is 64 KiB)."""


class ServerPipe:
    """Whole messages into a file descriptor, each behind its length, in as few system calls as can be; arrays are not copied on the way.

    One thread at a time writes.

    waits   whether a write waits for a reader after all, as on systems without `writev` (Windows): not for a thread that must not
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._rest: list[memoryview] = []
        self.waits = not hasattr(os, "writev")
        if not self.waits:
            os.set_blocking(handle, False)
        with suppress(ImportError, AttributeError, OSError):  # Linux alone; an unprivileged user's share may be used up
            import fcntl

            fcntl.fcntl(handle, fcntl.F_SETPIPE_SZ, CAPACITY)

    def write(self, messages: Iterable[PipeMessage]) -> None:
        """Take messages, and write what finds room; the rest waits here. Raises OSError if the reader has gone."""
        for message in messages:
            parts = [view for part in message if (view := memoryview(part)).nbytes]  # type: ignore[arg-type]
            self._rest += [memoryview(LENGTH.pack(sum(view.nbytes for view in parts))), *parts]
        self.flush()

    def flush(self) -> bool:
        """Write what waits; whether all of it has found room."""
        while self._rest and self.waits:
            self._rest[0] = np.frombuffer(self._rest[0], np.uint8).data[os.write(self._handle, self._rest[0]) :]
            del self._rest[: not self._rest[0].nbytes]
        while self._rest:
            try:
                written = os.writev(self._handle, [*islice(self._rest, MAX_BUFFERS)])
            except BlockingIOError:
                return False
            done = 0
            while done < len(self._rest) and written >= self._rest[done].nbytes:
                written -= self._rest[done].nbytes
                done += 1
            del self._rest[:done]
            if written:
                self._rest[0] = np.frombuffer(self._rest[0], np.uint8).data[written:]
        return True

    def wait(self, seconds: float) -> None:
        """Until there is room, or as long as this."""
        waiting = select.poll()
        waiting.register(self._handle, select.POLLOUT)
        waiting.poll(1000 * seconds)
