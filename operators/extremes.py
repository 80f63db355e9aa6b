"""Moving minimum and maximum over a window of samples.

Every channel keeps a queue of the values that can still become the extreme: each is more extreme than all that came after it. A new value
removes from the queue's end what it surpasses, so that each value enters and leaves once, and the queue's head is the answer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from operators.continuity import Continuity, Filter, numeric, regular, samples_in, watch
from stream.chunk import Array, Samples, Specs, StreamSpec, Times
from stream.kernel import kernel
from stream.operator import Case, grid
from stream.params import param


@kernel
def moving_extreme(
    x: Samples,
    sign: float,
    queue: Samples,
    numbers: Times,
    places: Times,
    time: Times,
    delay_ns: int,
    out: Samples,
    stamps: Times,
) -> None:
    """The largest of `sign` times the newest values of every channel of `x` (n, c), times `sign`, into `out` (n, c).

    queue    (w, c)  candidates, as a ring
    numbers  (w, c)  which sample of its channel each candidate was
    places   (3, c)  the head's place in the ring, how many candidates there are, and the next sample's number
    """
    w = queue.shape[0]
    for i in range(x.shape[0]):
        stamps[i] = time[i] - delay_ns
        for c in range(x.shape[1]):
            v = sign * x[i, c]
            if not abs(v) < math.inf:
                out[i, c] = math.nan
                continue
            head, size, number = places[0, c], places[1, c], places[2, c]
            if size > 0 and numbers[head, c] <= number - w:
                head = (head + 1) % w
                size -= 1
            while size > 0 and queue[(head + size - 1) % w, c] <= v:
                size -= 1
            queue[(head + size) % w, c] = v
            numbers[(head + size) % w, c] = number
            places[0, c], places[1, c], places[2, c] = head, size + 1, number + 1
            out[i, c] = sign * queue[head, c]


@dataclass(slots=True)
class ExtremeState(Continuity):
    sign: float
    queue: Samples
    numbers: Times
    places: Times


class Extreme(Filter[ExtremeState]):
    """The largest or smallest value of a moving window."""

    __slots__ = ()
    kernel = staticmethod(moving_extreme)
    sign: ClassVar[float]
    window_s: float
    reset_gap_s: float

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        rate_hz = regular(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        delay_s = (w - 1) / 2 / rate_hz
        seen = watch(specs["in"], delay_s=delay_s, reset_gap_s=self.reset_gap_s)
        c = seen["width"]
        state = ExtremeState(
            **seen,
            sign=self.sign,
            queue=np.zeros((w, c)),
            numbers=np.zeros((w, c), np.int64),
            places=np.zeros((3, c), np.int64),
        )
        self.hold(state, delay_s=delay_s)
        return {"out": spec.derive(settling_s=spec.settling_s + (w - 1) / rate_hz)}

    def rest(self) -> None:
        self.state.places[:] = 0

    def work(self, x: Samples, time: Times, out: Samples, stamps: Times) -> None:
        s = self.state
        moving_extreme(x, self.sign, s.queue, s.numbers, s.places, time, s.delay_ns, out, stamps)


@dataclass(frozen=True, slots=True)
class MovingMin(Extreme):
    """The smallest value of the newest `window_s`; stamps are those of the window's centre, half a window earlier (the declared delay).

    The window holds a number of samples, `window_s` times the rate, rounded; until it is full, what has come. Bad samples do not enter it.
    """

    sign: ClassVar[float] = -1.0
    window_s: float = param(above=0.0, help="length of the window")
    reset_gap_s: float = param(0.1, least=0.0, help="a longer gap empties the window")

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=0.25), _inputs(), least=500)]


@dataclass(frozen=True, slots=True)
class MovingMax(Extreme):
    """The largest value of the newest `window_s`; window, stamps and delay as in MovingMin."""

    sign: ClassVar[float] = 1.0
    window_s: float = param(above=0.0, help="length of the window")
    reset_gap_s: float = param(0.1, least=0.0, help="a longer gap empties the window")

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=0.25), _inputs(), least=500)]


def _inputs() -> dict[str, tuple[StreamSpec, Array, Array]]:
    data = np.random.default_rng(5).normal(size=(500, 3)).round(1)
    return {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 500), data)}
