"""How far a bed's clock is off: a request through the server, and what the bed's clock showed when it came."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from kinegraph.devices.nats.link import Link
from kinegraph.devices.nats.messages import subject
from kinegraph.stream.chunk import Times

ASKED_S, TRIES = 10.0, 5
ANSWER_S = 0.5
SLEW = 0.01
"""A new offset is taken over at this share of the pace of time, so that no stamp runs back."""


@dataclass(frozen=True, slots=True)
class Offset:
    """What is added to the bed's stamps to have the centre's, and how far that may be off (ns): half of the quickest round trip."""

    ns: int
    uncertainty_ns: int
    at: int


class BedClock:
    """Asks a bed for its time every 10 s, on the link's thread.

    offset   the last measurement; None: the bed has not answered yet
    """

    def __init__(self, link: Link, bed: str, now: Callable[[], int]) -> None:
        self._link, self._subject, self._now = link, subject(bed, "ask", "clock"), now
        self._due = 0.0
        self._asking = threading.Lock()
        self.offset: Offset | None = None

    def ask(self) -> None:
        """Measure, if it is time."""
        if time.monotonic() >= self._due and self._link.there and self._asking.acquire(blocking=False):
            self._due = time.monotonic() + (ASKED_S if self.offset else 1.0)
            self._link.start(self._measure())

    async def _measure(self) -> None:
        try:
            best: Offset | None = None
            for _ in range(TRIES):
                before = self._now()
                answer = await self._link.client.request(self._subject, b"", timeout=ANSWER_S)
                after = self._now()
                found = offset(before, int(json.loads(answer.data)["now"]), after)
                best = found if best is None or found.uncertainty_ns < best.uncertainty_ns else best
            self.offset = best
        except (TimeoutError, OSError, ValueError, KeyError, TypeError, self._link.error_kind):
            pass  # no bed answers: the offset stays as it was
        finally:
            with suppress(RuntimeError):
                self._asking.release()


def offset(before: int, bed: int, after: int) -> Offset:
    """Of a bed that showed `bed` between two moments of the centre (ns)."""
    return Offset((before + after) // 2 - bed, (after - before + 1) // 2, after)


class ClockMapping:
    """Moves a bed's stamps to the centre's clock; an offset that changes is taken over slowly."""

    def __init__(self, applied: int | None = None) -> None:
        self.applied = applied
        self._at: int | None = None

    def move(self, target: int | None, first: int) -> int:
        """The offset (ns) of a chunk that begins at `first` (the bed's ns), where `target` was measured last."""
        if target is not None:
            if self.applied is None:
                self.applied = target
            elif self._at is not None:
                most = round(SLEW * max(first - self._at, 0))
                self.applied += min(max(target - self.applied, -most), most)
        self._at = first if self._at is None else max(first, self._at)
        return self.applied or 0

    def stamps(self, time: Times, target: int | None, first: int) -> Times:
        return time + self.move(target, first)
