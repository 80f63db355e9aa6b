"""The protocol of a simulated device: bytes in, answers and packets out; no port, no thread, no clock."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


class DeviceModel(Protocol):
    """A simulated device without its cable. It begins at second 0, when it is switched on, and is asked in order."""

    def receive(self, data: bytes) -> bytes:
        """Bytes have come from the host; returns what the device answers."""

    def say(self, seconds: float) -> list[bytes]:
        """The packets that were sent since the last call, up to this second."""

    def restart(self) -> None:
        """Counters start again, as after a failing supply; what was set stays set."""


@runtime_checkable
class Clocked(Protocol):
    """A simulated device with its own time in its packets."""

    ahead_s: float
    """By how much its clock has been set forward."""
