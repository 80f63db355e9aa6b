"""One walk for simulated devices that are worn together: an EMG board on the muscles and an inertial sensor on the foot."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class SharedWalk:
    """How far the walk has come that several simulated devices show. The Cyton and the MTi ask; others carry both sensors themselves.

    A device that is switched on later joins in the middle of the walk. Outside of `watched` every walk begins when its device does,
    so that sample i is always the same.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._watchers = 0
        self._began: float | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """While any such context lasts, devices share the walk."""
        with self._lock:
            self._watchers += 1
        try:
            yield
        finally:
            with self._lock:
                self._watchers -= 1
                if not self._watchers:
                    self._began = None

    def samples(self, rate_hz: float) -> int:
        """At which sample of the walk a device begins that is switched on now; 0 for the first one."""
        with self._lock:
            if not self._watchers:
                return 0
            now = time.monotonic()
            if self._began is None:
                self._began = now
            return round((now - self._began) * rate_hz)


WALK = SharedWalk()
"""The walk of `--simulate`: one person for each process."""
