"""Fault injection between a simulated device and its host. Every simulator has the same settings; a seed repeats the faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.params import param


@dataclass(frozen=True, slots=True)
class FaultInjection:
    """How often each fault occurs. Shares are of packets; times count from the device's start. Every fault is off by default.

    lose, duplicate, corrupt   a packet is left out, sent twice, has one byte changed
    stall_every_s, stall_s     nothing is sent for so long, then everything at once
    reset_every_s              the device's counters start again
    jump_every_s, jump_s       the device's clock is set, forward or back, by this much
    unplug_every_s, unplug_s   the cable is pulled out in mid-packet, and put in again after so long
    """

    lose: float = param(0.0, least=0, most=1, help="share of packets that are left out")
    duplicate: float = param(0.0, least=0, most=1, help="share of packets that are sent twice")
    corrupt: float = param(0.0, least=0, most=1, help="share of packets of which one byte is changed")
    stall_every_s: float = param(0.0, least=0, help="how often nothing is sent for a while; 0: never")
    stall_s: float = param(0.1, above=0, help="how long nothing is sent")
    reset_every_s: float = param(0.0, least=0, help="how often the counters start again; 0: never")
    jump_every_s: float = param(0.0, least=0, help="how often the device's clock is set; 0: never")
    jump_s: float = param(3600.0, help="by how much it is set forward; below 0: back")
    unplug_every_s: float = param(0.0, least=0, help="how often the cable is pulled out; 0: never")
    unplug_s: float = param(1.0, above=0, help="how long the cable is out")
    from_s: float = param(0.0, least=0, help="nothing goes wrong before")
    seed: int = param(0, least=0, help="another seed, other packets")


GOOD = FaultInjection()


class FaultInjector:
    """Applies the faults to the packets of one device."""

    def __init__(self, faults: FaultInjection) -> None:
        self._of = faults
        self._random = np.random.default_rng([faults.seed, 0xBAD])
        self.lost = self.duplicated = self.corrupted = 0
        """How many packets were."""

    def spoil(self, packets: Sequence[bytes], seconds: float) -> list[bytes]:
        """The packets as they leave the device."""
        of = self._of
        if seconds < of.from_s or not (of.lose or of.duplicate or of.corrupt):
            return list(packets)
        sent: list[bytes] = []
        for packet in packets:
            lose, double, spoil = self._random.random(3)
            if lose < of.lose:
                self.lost += 1
                continue
            if spoil < of.corrupt:
                packet = self._corrupt(packet)
            sent.append(packet)
            if double < of.duplicate:
                self.duplicated += 1
                sent.append(packet)
        return sent

    def stalled(self, seconds: float) -> bool:
        """Whether nothing is sent at this second; it is kept and sent later."""
        return self._within(seconds, self._of.stall_every_s, self._of.stall_s)

    def unplugged(self, seconds: float) -> bool:
        """Whether the cable is out."""
        return self._within(seconds, self._of.unplug_every_s, self._of.unplug_s)

    def resets(self, seconds: float) -> int:
        """How often the counters have started again so far."""
        return self._times(seconds, self._of.reset_every_s)

    def jumped_s(self, seconds: float) -> float:
        """By how much the device's clock has been set so far."""
        return self._times(seconds, self._of.jump_every_s) * self._of.jump_s

    def _times(self, seconds: float, every_s: float) -> int:
        """How often what comes every `every_s` has come."""
        return int(max(0.0, seconds - self._of.from_s) / every_s) if every_s else 0

    def _within(self, seconds: float, every_s: float, for_s: float) -> bool:
        """Every `every_s` (the first time after as long), for `for_s`."""
        past = seconds - self._of.from_s
        return bool(every_s) and past >= every_s and past % every_s < for_s

    def _corrupt(self, packet: bytes) -> bytes:
        self.corrupted += 1
        at, change = int(self._random.integers(len(packet))), int(self._random.integers(1, 256))
        return packet[:at] + bytes([packet[at] ^ change]) + packet[at + 1 :]
