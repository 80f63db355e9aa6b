"""A simulated Arduino: prints the muscles of someone walking as lines of numbers, with its time or a counter where asked."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from kinegraph.devices.people.treadmill.signal import BURSTS, Signal, Walker
from kinegraph.devices.simulation.serve import Simulator, in_place
from kinegraph.stream.chunk import Samples
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.lines.source import AsciiLines

PER_S = {"ns": 1_000_000_000, "us": 1_000_000, "ms": 1000, "s": 1}
COUNTS_PER_UV = 0.5
MIDDLE = 512
MAX_BEHIND = 5000


@dataclass(frozen=True, slots=True)
class SimulatedAsciiLines(Simulator):
    """An Arduino with MyoWare sensors on a leg: ten-bit counts around 512, one line a sample."""

    port_name: ClassVar[str] = "ttyARDUINO"

    columns: tuple[str, ...] = param(("micros", "emg"), help="what a line holds, in this order")
    delimiter: str = param(",", help="between two numbers")
    header: bool = param(False, help="print the columns' names every second")
    rate_hz: float = param(500.0, above=0, most=5000, help="lines per second")
    time: str = param("micros", help="the column of the device's time; empty: no time")
    time_unit: Literal["ns", "us", "ms", "s"] = param("us", help="its unit")
    counter: str = param("", help="the column that counts lines; empty: no counter")
    counter_bits: int = param(16, least=1, most=32, help="after how many bits it starts again")
    seed: int = param(0, least=0, help="another seed, another walk")

    @property
    def cannot(self) -> dict[str, str]:
        counts = {self.time, self.counter} & set(self.columns)
        return {} if counts else {"reset_every_s": "its lines have neither a time nor a counter"}

    def brain(self) -> LinesModel:
        return LinesModel(self)


class LinesModel:
    """The Arduino without its cable. It speaks from when it is switched on, names its columns every second, and listens to nothing."""

    def __init__(self, of: SimulatedAsciiLines) -> None:
        self._of = of
        self._channels = [name for name in of.columns if name not in (of.time, of.counter)]
        muscles = tuple(list(BURSTS)[i % len(BURSTS)] for i in range(len(self._channels)))
        self._signal = Signal(Walker(muscles, rate_hz=max(200.0, of.rate_hz), seed=of.seed))
        self._said = 0
        self._zero = 0
        self.ahead_s = 0.0

    def receive(self, data: bytes) -> bytes:
        return b""

    def say(self, seconds: float) -> list[bytes]:
        due = int(seconds * self._of.rate_hz)
        sent = []
        for i in range(max(self._said, due - MAX_BEHIND), due):
            if self._of.header and (i - self._zero) % max(1, round(self._of.rate_hz)) == 0:
                sent.append((self._of.delimiter.join(self._of.columns) + "\r\n").encode())
            sent.append(self._line(i))
        self._said = max(self._said, due)
        return sent

    def restart(self) -> None:
        self._zero = self._said

    def counts(self, number: int) -> Samples:
        """What line `number` holds (channels,): whole counts, 0 to 1023."""
        at = round(number * self._signal.walker.rate_hz / self._of.rate_hz)
        emg = self._signal.read(at, at + 1)[0][0]
        return np.asarray(np.clip(np.round(MIDDLE + COUNTS_PER_UV * emg), 0, 1023))

    def _line(self, number: int) -> bytes:
        of, since = self._of, number - self._zero
        values = dict(zip(self._channels, self.counts(number), strict=True))
        fields = []
        for name in of.columns:
            if name == of.time:
                per = PER_S[of.time_unit]
                ticks = (round(since * per / of.rate_hz) + round(self.ahead_s * per)) % (1 << 32)
                fields.append(f"{since / of.rate_hz + self.ahead_s:.6f}" if of.time_unit == "s" else str(ticks))
            elif name == of.counter:
                fields.append(str(since % (1 << of.counter_bits)))
            else:
                fields.append(str(int(values[name])))
        return (of.delimiter.join(fields) + "\r\n").encode()


def simulated(source: AsciiLines) -> AbstractContextManager[AsciiLines]:
    """What `--simulate` puts in its place."""
    device = SimulatedAsciiLines(
        columns=source.columns,
        delimiter=source.delimiter,
        header=source.header,
        rate_hz=source.rate_hz or 100.0,
        time=source.time,
        time_unit=source.time_unit,
        counter=source.counter,
        counter_bits=source.counter_bits,
    )
    return in_place(source, device)
