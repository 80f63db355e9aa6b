"""What an operator with a memory knows of its input, where it is no `stream.filter.Filter` but writes `process`; the same gap rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, StreamSpec, Times
from kinegraph.stream.data.require import width_of


@dataclass(slots=True)
class Continuity:
    """The part of the state that tells gaps.

    nothing     (0, *shape) no samples, of the shape that comes in
    width       numbers per sample
    period_ns   nominal time between samples
    limit_ns    the longest gap that leaves the state as it is
    delay_ns    what is subtracted from stamps
    last        (1,) stamp of the newest sample seen
    """

    nothing: Samples
    width: int
    period_ns: int
    limit_ns: int
    delay_ns: int
    last: Times

    def gap_ns(self, chunk: Chunk) -> int:
        """How much time is missing before a chunk that holds samples."""
        return chunk.time.item(0) - self.last.item(0) - self.period_ns

    def breaks(self, chunk: Chunk) -> bool:
        """Whether the gap before this chunk is long enough to reset the state. Only for chunks with `lost`."""
        return len(chunk.time) > 0 and self.gap_ns(chunk) > self.limit_ns

    def missing(self, chunk: Chunk) -> int:
        """How many samples of the regular grid lie in the gap before this chunk, judged by its stamps."""
        return max(0, round(self.gap_ns(chunk) / self.period_ns))


def watch(spec: StreamSpec, *, delay_s: float = 0.0, reset_gap_s: float = 0.0) -> dict[str, Any]:
    """The fields of `Continuity` for an input."""
    return {
        "nothing": np.empty((0, *spec.shape)),
        "width": width_of(spec),
        "period_ns": spec.period_ns,
        "limit_ns": round(reset_gap_s * NS),
        "delay_ns": round(delay_s * NS),
        "last": np.array([NEVER]),
    }


def back(until: int, delay_ns: int) -> int:
    """Converts a promise about the input to one about an output with stamps `delay_ns` earlier."""
    return until - delay_ns if NEVER < until < FOREVER else until
