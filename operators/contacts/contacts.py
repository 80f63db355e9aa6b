"""Ground contact of one foot, as every operator that finds it tells it: a stream of touch-downs and a stream of lift-offs.

An event's stamp is the sample at which it was decided; `onset` is when the foot met or left the ground, which lies before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias, TypeVar

import numpy as np

from kinegraph.stream.chunk import NEVER, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Operator

CONTACT = np.dtype([("onset", "<i8")])
"""One contact: when it began, in ns of session time."""

Side: TypeAlias = Literal["left", "right", ""]


@dataclass(slots=True)
class Followed:
    """What every contact detector knows of its input: how long a gap it bears, and the stamp of the newest sample."""

    gap_ns: int
    last: int


F = TypeVar("F", bound=Followed)


class Contacts(Operator[F]):
    """A detector of the contacts of one foot: one numeric stream in, touch-downs and lift-offs out.

    A gap that it bears (see `reset_gap_s`) is bridged by the straight line between its ends, and not passed on: no contact is lost. After
    a longer one the detector starts again and the next contact of either kind is reported with `lost` = -1: some may be missing.
    A sample that is not finite counts as missing.
    """

    __slots__ = ()
    outputs: ClassVar[tuple[str, ...]] = ("touchdown", "liftoff")
    side: Side

    def contacts(self, spec: StreamSpec, settling_s: float = 0.0) -> Specs:
        """The output specs; what the input's `meta` says goes along."""
        meta = {**spec.meta, "side": self.side}
        made = StreamSpec((), CONTACT, units=("ns",), settling_s=spec.settling_s + settling_s, meta=meta)
        return {"touchdown": made, "liftoff": made}

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        time = chunk.time
        if not len(time):
            return [(name, Chunk(time, np.empty(0, CONTACT), chunk.until, chunk.lost)) for name in self.outputs]
        state = self.state
        broken = chunk.lost != 0 and state.last != NEVER and int(time[0]) - state.last > state.gap_ns
        found = np.empty((2, 2 * len(time) + 2, 2), np.int64)
        counts = self.follow(time, chunk.data, found)
        state.last = int(time[-1])
        return [
            (name, _contacts(found[k, : counts[k]], chunk.until, -1 if broken else 0))
            for k, name in enumerate(self.outputs)
        ]

    def follow(self, time: Times, data: Array, found: Times) -> tuple[int, int]:
        """Write touch-downs and lift-offs into `found` (2, 2 n + 2, 2) as (stamp, onset) in ns; returns how many of each."""
        raise NotImplementedError


def _contacts(found: Times, until: int, lost: int) -> Chunk:
    data = np.empty(len(found), CONTACT)
    data["onset"] = found[:, 1]
    return Chunk(np.ascontiguousarray(found[:, 0]), data, until, lost)


def signal_channels(spec: StreamSpec, wanted: Sequence[str], parameter: str) -> list[int]:
    """Indices of the `wanted` channels in a signal; all of them if `wanted` is empty."""
    if not spec.is_signal or spec.dtype.kind not in "iufb":
        raise InputError("in", spec.describe(), "a signal: rows of numeric channels")
    for name in wanted:
        if name not in spec.channels:
            raise ParameterError(parameter, name, f"a channel of the input; {nearest(name, spec.channels)}")
    return [spec.channels.index(name) for name in wanted] or list(range(spec.shape[0]))
