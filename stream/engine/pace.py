"""How fast a replay goes: a speed, pauses, steps and jumps, which may be asked for from another thread while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Condition

from kinegraph.stream.errors import KinegraphError

LONGEST_WAIT_S = 0.1
TOLD_EVERY_S = 0.1
NEVER_S = float("-inf")


class Pace:
    """Holds a replay back until a chunk is due. Session time is in s since the first input's arrival.

    speed    times real time; 0: it stands still
    at       how far the replay has come
    again    the moment to which it jumps back: it begins again and goes there without a rest; None: it goes on
    """

    def __init__(self, speed: float, *, forwards_only: bool = False) -> None:
        self.speed, self.at = speed, 0.0
        self.again: float | None = None
        self._forwards_only = forwards_only
        self._free_until = self._told_at = NEVER_S
        self._anchor: tuple[float, float] | None = None
        self._stopped = False
        self._changed = Condition()
        self._announce: Callable[[float, float], None] = lambda at, speed: None

    def report_to(self, tell: Callable[[float, float], None]) -> None:
        """Tell `tell` how far the replay is and its speed, some ten times a second."""
        self._announce = tell

    # from any thread -------------------------------------------------------------------------------------------------

    def go(self, speed: float) -> None:
        """Go on at this speed; 0 pauses."""
        with self._changed:
            self.speed, self._anchor = speed, None
            self._changed.notify()

    def step(self, seconds: float) -> None:
        """Go on for so long without a rest, and then stand still."""
        with self._changed:
            self.speed, self._anchor = 0.0, None
            self._free_until = max(self.at, self._free_until) + seconds
            self._changed.notify()

    def seek(self, to: float) -> None:
        """Go to a moment without a rest. Raises KinegraphError for an earlier one where the replay is recorded again."""
        with self._changed:
            if to < self.at and self._forwards_only:
                raise KinegraphError("a replay that is recorded (--out) only goes forwards")
            if to < self.at:
                self.again = to
            self._free_until, self._anchor = to, None
            self._changed.notify()

    def stop(self) -> None:
        """Hold nothing back any more."""
        with self._changed:
            self._stopped = True
            self._changed.notify()

    # the replay's own thread -----------------------------------------------------------------------------------------

    def begin_again(self) -> None:
        """The replay begins again."""
        with self._changed:
            self.again, self._anchor, self.at = None, None, 0.0

    def keep(self, session_s: float) -> bool:
        """Wait until what arrived at `session_s` is due; False: the replay is to begin again."""
        with self._changed:
            while not self._stopped and self.again is None and (rest := self._rest(session_s)) > 0:
                self._report()
                self._changed.wait(min(rest, LONGEST_WAIT_S))
            self.at = session_s
            self._report()
            return self.again is None

    def _rest(self, session_s: float) -> float:
        """How long to wait (s)."""
        if session_s <= self._free_until:
            self._anchor = None
            return 0.0
        if not self.speed:
            return LONGEST_WAIT_S
        now = time.monotonic()
        if self._anchor is None:
            self._anchor = (max(self.at, min(self._free_until, session_s)), now)
        begun, since = self._anchor
        return (session_s - begun) / self.speed - (now - since)

    def _report(self) -> None:
        now = time.monotonic()
        if now - self._told_at >= TOLD_EVERY_S:
            self._told_at = now
            self._announce(self.at, self.speed)
