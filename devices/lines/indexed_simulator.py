"""A simulated device that tells the truth about itself: its first column is each sample's true index, whatever its clock claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from kinegraph.devices.lines.simulator import MAX_BEHIND, PER_S
from kinegraph.devices.simulation.serve import Simulator
from kinegraph.stream.params import param


@dataclass(frozen=True, slots=True)
class Indexed(Simulator):
    """Lines of index, time, counter. Sample i was made i / rate_hz after the device was switched on, whatever its clock says."""

    port_name: ClassVar[str] = "ttyINDEXED"

    rate_hz: float = param(250.0, above=0, most=5000, help="lines per second, truly")
    time_unit: str = param("us", help="unit of the time: ns, us, ms or s")
    drift_ppm: float = param(0.0, help="how much faster the device's clock runs than true time")
    counter_bits: int = param(16, least=1, most=32, help="after how many bits the counter starts again")
    trailing: str = param("", help="what follows the last number")

    def brain(self) -> IndexedModel:
        return IndexedModel(self)


class IndexedModel:
    """The device without its cable; `ahead_s` sets its clock."""

    def __init__(self, of: Indexed) -> None:
        self._of = of
        self._said = self._zero = 0
        self.ahead_s = 0.0

    def receive(self, data: bytes) -> bytes:
        return b""

    def say(self, seconds: float) -> list[bytes]:
        due = int(seconds * self._of.rate_hz)
        sent = [self._line(i) for i in range(max(self._said, due - MAX_BEHIND), due)]
        self._said = max(self._said, due)
        return sent

    def restart(self) -> None:
        self._zero = self._said

    def _line(self, index: int) -> bytes:
        of, since = self._of, index - self._zero
        told_s = since / of.rate_hz * (1 + of.drift_ppm * 1e-6) + self.ahead_s
        text = f"{told_s:.6f}" if of.time_unit == "s" else str(round(told_s * PER_S[of.time_unit]))
        return f"{index},{text},{since % (1 << of.counter_bits)}{of.trailing}\r\n".encode()
