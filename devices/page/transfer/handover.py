"""What waits for a page's server, and how it is handed over: lines of the log, the engine's state, the samples of its channel."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

from kinegraph.devices.page.transfer.channel import TICK_S, UNSEEN_TICK_S, PageChannel, message
from kinegraph.devices.page.transfer.pipe import PipeMessage, ServerPipe
from kinegraph.devices.page.transfer.wire import encode
from kinegraph.stream.text.safe_text import plain

SEEN_TICK_S = 0.1
"""How soon what is left is handed over, where no further chunk comes; what comes regularly is handed over by those that bring it."""
LAST_S = 1.0
"""How long a server that has no room is waited for when a session ends."""
MAX_LINES = 200
"""Lines of the log that wait for the server; a page shows as many."""


class Handover:
    """All that is on its way to the server.

    channel  the samples
    lines    lines of the log, encoded; `note` adds to them from any thread
    state    the engine's metrics, encoded; only the newest matter
    pace     where a replay stands, encoded
    """

    def __init__(self, channel: PageChannel, over: threading.Event, *, live: bool) -> None:
        """`over`: set when the session ends; then the server is no longer waited for."""
        self.channel = channel
        self.lines: list[bytes] = []
        self.state = self.pace = b""
        self._writing = threading.Lock()
        self._over, self._live = over, live

    def note(self, line: bytes) -> None:
        """One more line of the log."""
        with self._writing:
            self.lines = [*self.lines[1 - MAX_LINES :], line]

    @property
    def tick_s(self) -> float:
        """How soon this thread has something to hand over: a picture, where a replay stands, or what others have left."""
        channel = self.channel
        if not channel.seen:
            return UNSEEN_TICK_S
        return TICK_S if channel.pictures_wanted or channel.is_left or not self._live else SEEN_TICK_S

    def give(self, pipe: ServerPipe) -> None:
        """Send all that waits, as soon as there is room."""
        with self._writing:
            lines, self.lines = self.lines, []
        (state, self.state), (pace, self.pace) = (self.state, b""), (self.pace, b"")
        messages: list[PipeMessage] = [[part] for part in (*lines, state, pace) if part]
        messages += map(message, self.channel.pictures())
        while not self.channel.hand_over(*messages) and self.channel.is_led and not self._over.is_set():
            pipe.wait(SEEN_TICK_S)

    def give_last(self, pipe: ServerPipe) -> None:
        """What is left at the end, and that this is the end."""
        end = time.monotonic() + LAST_S
        self.give(pipe)
        last = [encode({"t": "over", "why": "the session has ended"})]
        while not self.channel.hand_over(last) and self.channel.is_led and time.monotonic() < end:
            pipe.wait(SEEN_TICK_S)
        while not self.channel.hand_over() and self.channel.is_led and time.monotonic() < end:
            pipe.wait(SEEN_TICK_S)


def log_line(at: float, level: str, event: str, facts: Mapping[str, Any]) -> bytes:
    """A line of the log as the server takes it; `at`: Unix time (s)."""
    line = ", ".join(f"{key} {value}" for key, value in facts.items())
    text = plain(f"{event}{': ' if line else ''}{line}")[:500]
    return encode({"t": "log", "line": {"at": at, "level": level, "text": text}})
