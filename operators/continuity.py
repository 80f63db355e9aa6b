"""What every filter does alike: rows of float64 in, gaps judged against a limit, stamps moved back by the filter's delay.

The gap rule. A gap shows as `chunk.lost != 0`. Its length is the time from the last sample before it to the first one after it, less one
period. Up to the operator's `reset_gap_s` the state is held, as if the samples on both sides were neighbours; beyond it the state is
reset. `lost` is passed on at the same place either way, and the output's `settling_s` says for how long values are not settled after it.

The rule for bad samples. NaN in gives NaN out and holds the state, channel by channel; plus and minus infinity are treated as NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np

from stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Samples, StreamSpec, Times
from stream.errors import InputError, ParameterError
from stream.operator import Operator, Step
from stream.spare import Spare


@dataclass(slots=True)
class Continuity:
    """What a filter knows of its input; the part of its state that all filters share.

    plain       whether chunks are (n, width) float64 already
    width       numbers per sample
    period_ns   nominal time between samples
    limit_ns    the longest gap that leaves the state as it is
    delay_ns    what is subtracted from stamps
    last        (1,) stamp of the newest sample seen
    spare       arrays for what goes out
    """

    plain: bool
    width: int
    period_ns: int
    limit_ns: int
    delay_ns: int
    last: Times
    spare: Spare

    def gap_ns(self, chunk: Chunk) -> int:
        """How much time is missing before a chunk that holds samples."""
        return chunk.time.item(0) - self.last.item(0) - self.period_ns

    def breaks(self, chunk: Chunk) -> bool:
        """Whether the gap before this chunk is long enough to reset the state. Only for chunks with `lost`."""
        return len(chunk.time) > 0 and self.gap_ns(chunk) > self.limit_ns

    def missing(self, chunk: Chunk) -> int:
        """How many samples of the regular grid lie in the gap before this chunk, judged by its stamps."""
        return max(0, round(self.gap_ns(chunk) / self.period_ns))


C = TypeVar("C", bound=Continuity)


class Filter(Operator[C]):
    """A filter of one numeric stream: one sample out per sample in, later by the declared delay.

    Takes signals (channels,) and any other numeric samples, such as markers (points, 3): every number of a sample is filtered for itself.
    Subclasses give `rest` and `work`, or their own `process`; and `kernel`, the one that `work` calls, if its parameters are what a
    `Step` may have.
    """

    __slots__ = ()
    contiguous = True
    kernel: ClassVar[Callable[..., None] | None] = None

    def kernel_step(self) -> Step | None:
        state, kernel = self.state, type(self).kernel
        return Step(kernel, state, last=state.last) if kernel else None

    def rest(self) -> None:
        """Forget all samples: back to the state at the start."""

    def work(self, x: Samples, time: Times, out: Samples, stamps: Times) -> None:
        """Filter `x` (n, width) into `out`, and move `time` (n,) back by the delay into `stamps`: one kernel call."""
        raise NotImplementedError

    def process(self, port: str, chunk: Chunk) -> Chunk:
        state = self.state
        time = chunk.time
        n = len(time)
        if not n:
            return nothing(chunk, state)
        if chunk.lost and state.breaks(chunk):
            self.rest()
        state.last[0] = time[-1]
        x = chunk.data
        out, stamps = state.spare.both(n)
        made = out
        if not state.plain:
            x, made = rows(x, state.width), out.reshape(x.shape)
        self.work(x, time, out, stamps)
        until = chunk.until
        return Chunk(stamps, made, until if until == FOREVER else until - state.delay_ns, chunk.lost)


def watch(spec: StreamSpec, *, delay_s: float = 0.0, reset_gap_s: float = 0.0) -> dict[str, Any]:
    """The fields of `Continuity` for an input."""
    width = int(np.prod(spec.shape, dtype=np.int64))
    return {
        "plain": spec.dtype == np.float64 and len(spec.shape) == 1,
        "width": width,
        "period_ns": spec.period_ns,
        "limit_ns": round(reset_gap_s * NS),
        "delay_ns": round(delay_s * NS),
        "last": np.array([NEVER]),
        "spare": Spare(width),
    }


def numeric(spec: StreamSpec, port: str = "in") -> StreamSpec:
    """The spec, if its samples are numbers; as an output it is float64."""
    if spec.is_event or spec.dtype.kind not in "iufb":
        raise InputError(port, spec.describe(), "a stream of numbers (a signal, markers or frames), not of events")
    return spec.derive(dtype=np.dtype(np.float64))


def regular(spec: StreamSpec, port: str = "in") -> float:
    """The rate in Hz of a regular stream."""
    if spec.rate_hz is None:
        raise InputError(
            port,
            spec.describe(),
            "regular: its rate must be known; join it to a regular stream with operators.align.Align",
        )
    return spec.rate_hz


def samples_in(parameter: str, seconds: float, rate_hz: float) -> int:
    """How many samples a window of `seconds` holds, rounded; at least one."""
    n = round(seconds * rate_hz)
    if n < 1:
        raise ParameterError(parameter, seconds, f"at least {1 / rate_hz:g} (one sample at {rate_hz:g} Hz)")
    return n


def rows(data: Array, width: int) -> Samples:
    """Samples of any numeric dtype and shape as C-contiguous float64 rows (n, width)."""
    return np.ascontiguousarray(data, np.float64).reshape(len(data), width)


def back(until: int, delay_ns: int) -> int:
    """A promise about the input, as a promise about an output whose stamps are `delay_ns` earlier."""
    return until - delay_ns if NEVER < until < FOREVER else until


def nothing(chunk: Chunk, state: Continuity) -> Chunk:
    """What a filter gives back for an empty chunk: time passes."""
    data = chunk.data if state.plain else np.empty(chunk.data.shape)
    return Chunk(chunk.time, data, back(chunk.until, state.delay_ns), chunk.lost)
