"""What goes wrong in real EMG sessions, made on purpose, so that what must notice it can be tried."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.people.treadmill.signal import Indices, Signal, random
from kinegraph.stream.chunk import Samples
from kinegraph.stream.params import param

_FAULTS = 16
_PACKET = 10


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of some seconds.

    flat        an electrode has come off: the channel reads 0
    hum         the mains: 50 Hz and a third of it at 150 Hz, `size_uv` high
    clipping    the amplifier's range ends at +-`size_uv`
    artefacts   the cable swings: after one footfall in two, the channel is thrown by some `size_uv` for 0.15 s
    weak        the muscle tires, or its electrode has moved: the channel has the given `share` of its size
    noise       a dry electrode: white noise of `size_uv` rms
    lost        packets of 10 samples (all muscles) are lost, the given `share` of them
    stall       nothing arrives, then everything at once (only in real time)
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    kind: Literal["flat", "hum", "clipping", "artefacts", "weak", "noise", "lost", "stall"]
    muscle: str = param("", help="the channel; left out: all of them")
    from_s: float = param(0.0, least=0, help="when the fault begins, counted from the first sample")
    for_s: float = param(0.0, least=0, help="how long it lasts; 0: to the end")
    size_uv: float = param(200.0, above=0, help="hum, clipping, artefacts, noise: how large")
    share: float = param(1.0, above=0, most=1, help="lost: which share of the packets; weak: of the size")


class Faults:
    """Applies faults to a signal; like the signal, a function of the sample's index alone."""

    def __init__(self, faults: tuple[Fault, ...], signal: Signal) -> None:
        self._faults = list(enumerate(faults))
        self._signal = signal
        self._rate = signal.walker.rate_hz

    def spoil(self, start: int, emg: Samples) -> None:
        """Change `emg` (n, muscles), which begins at sample `start`, in place."""
        index = np.arange(start, start + len(emg))
        for number, fault in self._faults:
            hit = self._during(fault, index)
            if hit.any():
                muscles = self._signal.walker.muscles
                for column in [muscles.index(fault.muscle)] if fault.muscle else range(len(muscles)):
                    emg[hit, column] = self._spoil(fault, number, column, index[hit], emg[hit, column])

    def arrived(self, start: int, stop: int) -> NDArray[np.bool_]:
        """Which of the samples start..stop-1 were not lost on their way."""
        index = np.arange(start, stop)
        here = np.ones(len(index), bool)
        for number, fault in self._faults:
            if fault.kind == "lost":
                first, last = start // _PACKET, (stop - 1) // _PACKET
                draws = [random(self._signal.walker.seed, _FAULTS + number, p).random() for p in range(first, last + 1)]
                dropped = np.array(draws)[index // _PACKET - first] < fault.share
                here &= ~(dropped & self._during(fault, index))
        return here

    def stalled_until(self, index: int) -> float:
        """The time in s, counted from the first sample, before which a sample does not arrive."""
        at = index / self._rate
        ends = [f.from_s + (f.for_s or np.inf) for _, f in self._faults if f.kind == "stall" and f.from_s <= at]
        return max([at, *(end for end in ends if at < end)])

    def _during(self, fault: Fault, index: Indices) -> NDArray[np.bool_]:
        at = index / self._rate
        return np.asarray((at >= fault.from_s) & (at < fault.from_s + (fault.for_s or np.inf)))

    def _spoil(self, fault: Fault, number: int, column: int, index: Indices, x: Samples) -> Samples:
        match fault.kind:
            case "flat":
                return np.zeros_like(x)
            case "hum":
                turn = 2 * np.pi * 50.0 * index / self._rate + column
                return np.asarray(x + fault.size_uv * (np.sin(turn) + np.sin(3 * turn) / 3))
            case "clipping":
                return np.clip(x, -fault.size_uv, fault.size_uv)
            case "weak":
                return fault.share * x
            case "noise":
                return x + fault.size_uv * self._white(number, column, index)
            case "artefacts":
                return x + fault.size_uv * self._swings(number, column, index)
            case "lost" | "stall":
                return x

    def _white(self, number: int, column: int, index: Indices) -> Samples:
        """Noise in blocks of 100 samples, so that a sample's does not depend on what is asked for with it."""
        first = int(index[0]) // 100
        purpose = _FAULTS + number + (column << 16)
        blocks = [
            random(self._signal.walker.seed, purpose, b).standard_normal(100)
            for b in range(first, int(index[-1]) // 100 + 1)
        ]
        return np.asarray(np.concatenate(blocks)[index - 100 * first])

    def _swings(self, number: int, column: int, index: Indices) -> Samples:
        gait, total = self._signal.gait, np.zeros(len(index))
        for cycle in range(gait.cycle_at(int(index[0])) - 1, gait.cycle_at(int(index[-1])) + 1):
            happens, size, late = random(
                self._signal.walker.seed, _FAULTS + number + (column << 16), cycle + (1 << 32)
            ).random(3)
            after = (index - gait.touchdown(cycle)) / self._rate - 0.02 * late
            swing = np.where(after > 0, np.sin(2 * np.pi * 6.0 * after) * np.exp(-after / 0.05), 0.0)
            total += (happens < 0.5) * (1 + size) * swing
        return total
