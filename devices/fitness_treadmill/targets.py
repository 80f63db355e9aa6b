"""What a graph asks of a treadmill: left by an outlet, taken by the source that holds the connection."""

from __future__ import annotations

import threading


class Targets:
    """The newest wish of each kind; safe between threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._wanted: dict[int, float] = {}
        self._used = False

    def set(self, kind: int, value: float) -> None:
        with self._lock:
            self._wanted[kind] = value

    def take(self) -> list[tuple[int, float]]:
        """What was asked for since the last call."""
        with self._lock:
            wanted, self._wanted = list(self._wanted.items()), {}
            self._used = self._used or bool(wanted)
        return wanted

    def forget(self) -> bool:
        """Begin again; whether anything was set before."""
        with self._lock:
            used, self._used, self._wanted = self._used, False, {}
        return used


_known: dict[str, Targets] = {}
_lock = threading.Lock()


def targets_of(device: str) -> Targets:
    """Those of the treadmill that a source and an outlet both call so."""
    with _lock:
        return _known.setdefault(device, Targets())
