"""The state of filters that follow how fast each channel changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from kinegraph.stream.chunk import NEVER, Samples, StreamSpec, Times
from kinegraph.stream.data.require import width_of
from kinegraph.stream.filter import FilterState


@dataclass(slots=True, kw_only=True)
class SlopeState(FilterState):
    """value (c,): the newest values, slope (c,): their smoothed change per second, when (c,): the stamps of the newest finite ones."""

    value: Samples
    slope: Samples
    when: Times

    @classmethod
    def of(cls, spec: StreamSpec) -> Self:
        """Before the first sample."""
        c = width_of(spec)
        return cls(value=np.zeros(c), slope=np.zeros(c), when=np.full(c, NEVER))
