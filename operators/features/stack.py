"""Stacking: each frame beside some frames before and after it, so that a pose also says where it is going (thesis 2.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.inputs.continuity import Continuity, watch
from kinegraph.stream.chunk import FOREVER, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import numeric, regular
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

MOST = 64
FARTHEST = 10_000


@kernel
def together(first: int, then: int) -> int:
    """The sum of two numbers of lost frames, where -1 stands for some."""
    return -1 if first < 0 or then < 0 else first + then


@kernel
def stack(
    x: Samples,
    ring: Samples,
    places: Times,
    offsets: Times,
    time: Times,
    lost: int,
    furthest: int,
    past: Times,
    out: Samples,
    when: Times,
) -> int:
    """Rows side by side: `out` (n, o c) for those rows of `x` (n, c) that complete a stack.

    ring      (span + 1, c)  the newest rows
    places    (3,)           the place in the ring filled next, how many are filled, how many frames before them will not come out
    offsets   (o,)           which rows, counted back from the newest: span .. 0 for the oldest .. newest
    lost      frames missing before the first row; rows further apart in time than `furthest` do not stand in one stack
    past      (2, ahead + 1) stamps of the newest rows, and how many are lost before each; the stack's own is the oldest of them
    when      (2, n)         per stack: the stamp of its own frame, and how many are lost before it

    Returns how many stacks were made.
    """
    span, ahead = ring.shape[0] - 1, past.shape[1] - 1
    width = x.shape[1]
    made = 0
    for i in range(x.shape[0]):
        at = places[0]
        for c in range(width):
            ring[at, c] = finite(x[i, c])
        if places[1] and time[i] - past[0, ahead] > furthest:
            places[1] = 0
            places[2] = -1
        for k in range(ahead):
            past[0, k] = past[0, k + 1]
            past[1, k] = past[1, k + 1]
        past[0, ahead] = time[i]
        past[1, ahead] = lost if i == 0 else 0
        if places[1] < span - ahead:
            places[2] = together(places[2], past[1, ahead])
        places[0] = 0 if at == span else at + 1
        places[1] = min(places[1] + 1, span + 1)
        if places[1] <= span:
            continue
        for o in range(offsets.shape[0]):
            row = at - offsets[o]
            row += span + 1 if row < 0 else 0
            for c in range(width):
                out[made, o * width + c] = ring[row, c]
        when[0, made] = past[0, 0]
        when[1, made] = together(places[2], past[1, 0])
        places[2] = 0
        made += 1
    return made


@dataclass(slots=True)
class StackState(Continuity):
    ring: Samples
    places: Times
    offsets: Times
    past: Times


@dataclass(frozen=True, slots=True)
class Stack(Operator[StackState]):
    """Frames (width,) in; out come frames (offsets x width,): the frames at all offsets side by side, under the stamp of offset 0.

    offsets  in frames, each once: negative ones reach back, positive ones ahead. The delay is the largest
    causal   moves all offsets back until all are at most 0: no delay, but the stamp is then the newest frame's, and cuts found in such
             features are some 5 points of F1 worse than with the centred ones

    The offsets count frames: fill gaps first where frames are dropped (operators.filters.gaps.FillGaps). Frames with an incomplete
    stack, at
    the start, at the end and around a gap longer than `reset_gap_s`, do not come out. A bad value is NaN in every stack that holds it.
    Points (points, 3) are laid flat. `meta["stack"]` holds the offsets and the number of features, from which a radius R per single number
    becomes R sqrt(offsets x features).

    >>> Stack(offsets=[-1, 0])(np.arange(4.0), rate_hz=30)
    array([[0., 1.],
           [1., 2.],
           [2., 3.]])
    """

    inputs = {"in": Input(rows=True)}
    offsets: tuple[int, ...] = param((-10, -5, 0, 5, 10), least=-FARTHEST, most=FARTHEST, help="in frames")
    causal: bool = param(False, help="offsets moved back until all are at most 0")
    reset_gap_s: float = reset_gap(0.5)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        flat = numeric(spec)
        rate_hz = regular(spec)
        offsets = self._offsets()
        span, ahead = offsets[-1] - min(offsets[0], 0), offsets[-1]
        seen = watch(spec, delay_s=ahead / rate_hz, reset_gap_s=self.reset_gap_s)
        state = StackState(
            **seen,
            ring=np.zeros((span + 1, seen["width"])),
            places=np.zeros(3, np.int64),
            offsets=np.array([ahead - offset for offset in offsets], np.int64),
            past=np.zeros((2, ahead + 1), np.int64),
        )
        self.set_state(state, delay_s=ahead / rate_hz)
        names, units = flat_names(spec), flat_units(spec)
        made = flat.derive(
            shape=(len(offsets) * seen["width"],),
            channels=tuple(f"{name}[{offset:+d}]" for offset in offsets for name in names),
            units=units if len(units) == 1 else units * len(offsets),
            channel_axis=0,
            meta={**spec.meta, "stack": {"offsets": list(offsets), "features": seen["width"]}},
        )
        return {"out": made}

    def _offsets(self) -> tuple[int, ...]:
        """The offsets in order, limited to known frames; the span always holds offset 0, which gives the stamp."""
        given = self.offsets
        if not 1 <= len(given) <= MOST or len(set(given)) < len(given):
            raise ParameterError("offsets", list(given), f"a list of 1 to {MOST} different numbers of frames")
        if self.causal:
            return tuple(sorted(offset - max(given) for offset in given))
        if max(given) < 0:
            raise ParameterError("offsets", list(given), "a list with a largest offset of at least 0, the frame itself")
        return tuple(sorted(given))

    def process(self, port: str, chunk: Chunk) -> Emitted:
        s = self.state
        n = len(chunk.time)
        out, when = np.empty((n, len(s.offsets) * s.width)), np.empty((2, n), np.int64)
        made = 0
        if n:
            s.last[0] = chunk.time[-1]
            furthest = s.limit_ns + s.period_ns
            made = stack(chunk.data, s.ring, s.places, s.offsets, chunk.time, chunk.lost, furthest, s.past, out, when)
        return pieces(when[0, :made], out[:made], when[1, :made], self._promise(chunk.until))

    def _promise(self, until: int) -> int:
        """No later stack has a stamp at or before this: not before the oldest frame that still waits for its stack."""
        s = self.state
        span, ahead = len(s.ring) - 1, s.past.shape[1] - 1
        known = min(int(s.places[1]), span)
        behind = known - 1 - (span - ahead)
        if until == FOREVER or behind < 0 or until - s.last.item(0) > s.limit_ns + s.period_ns:
            return until
        return min(until, int(s.past[0, ahead - behind]) - 1)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(21)
        pose = StreamSpec((4,), rate_hz=30.0, channels=("a", "b", "c", "d"), units=("cm",))
        points = StreamSpec((2, 3), np.dtype(np.float32), 30.0, channels=("hip", "knee"), units=("m",))
        data = rng.normal(size=(300, 4)).cumsum(axis=0)
        return [
            Case(cls(), {"in": (pose, grid(30.0, 300), data)}, least=280),
            Case(cls(causal=True), {"in": (pose, grid(30.0, 300), data)}, least=280),
            Case(cls(offsets=(3, -7)), {"in": (points, grid(30.0, 200), rng.normal(size=(200, 2, 3)))}, least=190),
        ]


def pieces(time: Times, data: Samples, lost: Times, until: int) -> Emitted:
    """A chunk, or several that begin where samples are missing."""
    whole = Chunk(time, data, until)
    starts = [0, *(int(k) for k in np.flatnonzero(lost) if k)]
    made = [whole.part(a, b) for a, b in zip(starts, [*starts[1:], len(time)], strict=True)]
    for start, piece in zip(starts, made, strict=True):
        piece.lost = int(lost[start]) if len(time) else 0
    return [("out", piece) for piece in made]


def flat_names(spec: StreamSpec) -> tuple[str, ...]:
    """Names of a sample's numbers laid flat: the channels', or point and coordinate ("hip.x"), or numbers."""
    width = int(np.prod(spec.shape, dtype=np.int64))
    if len(spec.shape) == 1:
        return spec.channels or tuple(map(str, range(width)))
    if len(spec.shape) == 2 and spec.shape[1] == 3 and (spec.channel_axis == 0 or not spec.channels):
        points = spec.channels or tuple(map(str, range(spec.shape[0])))
        return tuple(f"{point}.{axis}" for point in points for axis in "xyz")
    return tuple(map(str, range(width)))


def flat_units(spec: StreamSpec) -> tuple[str, ...]:
    """Units of a sample's numbers laid flat: one for all, or one each."""
    if len(set(spec.units)) == 1:
        return spec.units[:1]
    if len(spec.shape) == 2 and spec.channel_axis == 0:
        return tuple(unit for unit in spec.units for _ in range(spec.shape[1]))
    return spec.units if len(spec.shape) == 1 else ("",)
