"""A simulated device on a cable of made-up time: what it says arrives when the script has it, so that a minute takes a second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from kinegraph.devices.simulation.device_model import DeviceModel
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection, FaultInjector
from kinegraph.stream.chunk import NS
from kinegraph.stream.source import Source
from tests.support.device_feed import Kept

STEP_S = 0.002
BEGAN = 1_767_225_600 * NS


class Arriving(Kept):
    """A feed with the script's clock. `arrivals`: when each chunk of each output was emitted (ns)."""

    def __init__(self) -> None:
        super().__init__()
        self.at = BEGAN

    def now(self) -> int:
        return self.at

    def wait(self, seconds: float) -> bool:
        return self.stopped


@dataclass
class Cable:
    """Gives what the brain says `delay_s(second)` later, in order, until `seconds` are over."""

    brain: DeviceModel
    feed: Arriving
    seconds: float
    delay_s: Callable[[float], float]
    injector: FaultInjector
    now_s: float = 0.0
    due: list[tuple[float, bytes]] = field(default_factory=list)
    answers: bytes = b""
    resets: int = 0

    def read(self, timeout_s: float) -> bytes:
        if self.answers or not timeout_s:
            given, self.answers = self.answers, b""
            return given
        self.now_s += STEP_S
        if self.now_s > self.seconds:
            self.feed.stop()
            return b""
        if self.injector.resets(self.now_s) > self.resets:
            self.resets += 1
            self.brain.restart()
        self.brain.ahead_s = self.injector.jumped_s(self.now_s)  # type: ignore[attr-defined]
        reported = b"".join(self.injector.spoil(self.brain.say(self.now_s), self.now_s))
        if reported:
            at = max(self.now_s + self.delay_s(self.now_s), self.due[-1][0] if self.due else 0.0)
            self.due.append((at, reported))
        come = [data for at, data in self.due if at <= self.now_s]
        self.due = self.due[len(come) :]
        self.feed.at = BEGAN + round(self.now_s * NS)
        return b"".join(come)

    def write(self, data: bytes) -> None:
        self.answers += self.brain.receive(data)

    def close(self) -> None: ...

    def __enter__(self) -> Cable:
        return self

    def __exit__(self, *_: object) -> None: ...


def played(
    source: Source,
    brain: DeviceModel,
    seconds: float,
    monkeypatch: pytest.MonkeyPatch,
    faults: FaultInjection = GOOD,
    jitter_s: float = 0.003,
) -> Arriving:
    """What the source made of so many seconds of the device; each packet comes .5 ms late and up to `jitter_s` more."""
    feed, random = Arriving(), np.random.default_rng(5)
    cable = Cable(brain, feed, seconds, lambda _: 0.0005 + jitter_s * float(random.random()), FaultInjector(faults))
    monkeypatch.setattr("kinegraph.devices.transport.serial_source.connect", lambda *_: cable)
    monkeypatch.setattr("kinegraph.devices.clocks.clock_log.time.monotonic", lambda: cable.now_s)
    source.specs()
    source.prepare()
    source.read(feed)
    return feed
