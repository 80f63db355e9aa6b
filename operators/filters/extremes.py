"""Moving minimum and maximum over a window of samples.

Every channel keeps a queue of the values that can still become the extreme: each is more extreme than all that came after it. A new value
removes from the queue's end what it surpasses, so that each value enters and leaves once, and the queue's head is the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Array, Samples, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, samples_in, width_of
from kinegraph.stream.filter import Filter, FilterState
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param


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
            v = out[i, c] = finite(sign * x[i, c])
            if v != v:
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
class ExtremeState(FilterState):
    queue: Samples
    numbers: Times
    places: Times


class _Extreme(Filter[ExtremeState]):
    """The largest or smallest value of a moving window."""

    delays: ClassVar[str] = "half the window"
    __slots__ = ()
    kernel = moving_extreme
    sign: ClassVar[float]
    window_s: float

    def begin(self, spec: StreamSpec) -> ExtremeState:
        rate_hz, c = regular(spec), width_of(spec)
        w = samples_in("window_s", self.window_s, rate_hz)
        return ExtremeState(
            delay_s=(w - 1) / 2 / rate_hz,
            settling_s=(w - 1) / rate_hz,
            queue=np.zeros((w, c)),
            numbers=np.zeros((w, c), np.int64),
            places=np.zeros((3, c), np.int64),
        )


@dataclass(frozen=True, slots=True)
class MovingMin(_Extreme):
    """The smallest value of the newest `window_s`; stamps are those of the window's centre, half a window earlier (the declared delay).

    The window holds a number of samples, `window_s` times the rate, rounded; until it is full, what has come. Bad samples do not enter it.

    >>> MovingMin(window_s=0.03)(np.array([1.0, 5.0, 2.0, 0.0, 3.0]), rate_hz=100)
    array([1., 1., 1., 0., 0.])
    """

    sign: ClassVar[float] = -1.0
    window_s: float = param(above=0.0, help="length of the window")

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=0.25), _inputs(), least=500)]


@dataclass(frozen=True, slots=True)
class MovingMax(_Extreme):
    """The largest value of the newest `window_s`; window, stamps and delay as in MovingMin.

    >>> MovingMax(window_s=0.03)(np.array([1.0, 5.0, 2.0, 0.0, 3.0]), rate_hz=100)
    array([1., 5., 5., 5., 3.])
    """

    sign: ClassVar[float] = 1.0
    window_s: float = param(above=0.0, help="length of the window")

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(window_s=0.25), _inputs(), least=500)]


def _inputs() -> dict[str, tuple[StreamSpec, Array, Array]]:
    data = np.random.default_rng(5).normal(size=(500, 3)).round(1)
    return {"in": (StreamSpec((3,), rate_hz=100.0), grid(100.0, 500), data)}
