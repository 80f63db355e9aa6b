"""Electrodes' impedances, where a device measures them itself, with a current of its own, before a session."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import structlog

from kinegraph.stream.chunk import FOREVER, NEVER, Chunk

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Impedance:
    """One electrode of a channel: `pole` "+", "-", or "" where there is one only; `ohm` at `hz`, infinite if it seems disconnected."""

    channel: str
    pole: str
    ohm: float
    hz: float


class LoneFeed:
    """A feed without a graph: for asking a device something before a session. What it emits is lost, what it says is in the log."""

    again = False

    def __init__(self) -> None:
        self._stop = threading.Event()

    def stop(self) -> None:
        self._stop.set()

    def emit(self, chunk: Chunk, output: str = "out") -> None: ...

    def now(self) -> int:
        return time.time_ns()

    def wait(self, seconds: float) -> bool:
        return self._stop.wait(seconds)

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def ready(self) -> None: ...

    def listen(self, timeout_s: float) -> str | None:
        return None

    def identify(self, device: str, **facts: str | float) -> None:
        log.info("device", device=device, **facts)

    def problem(self, kind: str, count: int = 1) -> None:
        log.info("device problem", kind=kind, count=count)

    def tell(self, kind: str, **facts: str | float) -> None:
        log.info(kind, **facts)

    def device_clock(self, **facts: float) -> None: ...

    def position(self, output: str = "out") -> int:
        return NEVER

    def saved(self) -> int:
        return FOREVER
