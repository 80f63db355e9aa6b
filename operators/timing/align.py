"""Joining streams of different rates and devices on time, into one signal, or one stream of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from kinegraph.operators.inputs.channels import names_of
from kinegraph.operators.inputs.directions import TURN, turned_to
from kinegraph.operators.inputs.lengths import length_of, metres
from kinegraph.operators.timing.align_lane import METHODS, AlignedInput
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.require import numeric, width_of
from kinegraph.stream.domain.axes import BODY, CAMERA, Axes, describe_axes
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import ANY, Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

Turn: TypeAlias = tuple[tuple[int, int, int], Samples]
"""By coordinate of the first input: which of an input's it is, and times what."""
ONE_BODY = ("skeleton", "mesh", "bones", "landmarks")
"""Facts of one body's points, which are not those of several."""


@dataclass(slots=True)
class AlignState:
    lanes: list[AlignedInput]
    """One per input, in port order."""
    until: int
    """All streams are complete up to this time."""
    anchor: int
    """Stamp of the grid's row 0; NEVER until there is a sample."""
    row: int
    """The grid's next row."""
    missing: int
    """How many rows of the grid were left out since the last one that was emitted."""


class _Joining(Operator[AlignState]):
    """What does not change while samples come: the shape of a row; of points, what makes each input's those of the first input."""

    __slots__ = ("shape", "turns")
    shape: tuple[int, ...]
    turns: dict[str, Turn | None]


@dataclass(frozen=True, slots=True)
class Align(_Joining):
    """The channels of all inputs side by side, at the stamps of the first input, or on a common grid of `rate_hz`.

    Between the samples of a stream its value is found by `method`: on a straight line between the samples on both sides (linear), from the
    newest sample at or before (hold), or from the nearest one. Samples further away than `max_distance_s` do not count, for linear on
    either side; without one the value is NaN. A bad sample counts as it is: NaN.

    stamps   of the first stream: each of its samples comes out, with its own values, and its gaps are passed on; gaps of the others show
             as NaN. On the grid: from the earliest sample of all on, evenly; rows at which no stream has a value are left out and counted
             in `lost`
    delay    a row waits for each stream's next sample, for `max_distance_s` at most; `hold` waits for nothing
    names    as they are; those that several streams share get the input's name before them, as in "board.x". Streams without names
             are called by their input's name and a number
    points   markers (points, 3), of several people, say, become one stream of all their points, in the first one's unit and axes; those
             of an input that declares other axes are turned

    No anti-alias filter is in it: a stream that is much faster than the rows should be low-passed first.

    >>> fast, slow = series(np.arange(4.0), rate_hz=100), series(np.array([0.0, 10.0]), rate_hz=50)
    >>> apply(Align(), a=fast, b=slow)
    array([[ 0.,  0.],
           [ 1.,  5.],
           [ 2., 10.],
           [ 3., nan]])
    """

    delays: ClassVar[str] = "`max_distance_s`; `hold`: no delay"
    inputs = {ANY: Input(in_turn=False)}
    rate_hz: float | None = param(None, above=0.0, help="rate of a common grid; left out: the first input's stamps")
    method: Literal["linear", "hold", "nearest"] = param("linear", help="how a value between samples is found")
    max_distance_s: float | None = param(
        None, above=0.0, help="samples further away do not count; left out: 1.5 periods"
    )

    def open(self, specs: Specs) -> Specs:
        leader = next(iter(specs.values()))
        points = len(leader.shape) == 2 and leader.shape[1] == 3
        lanes: list[AlignedInput] = []
        for port, spec in specs.items():
            numeric(spec, port)
            if points != (len(spec.shape) == 2 and spec.shape[1] == 3) or not (points or spec.is_signal):
                raise InputError(
                    port,
                    spec.describe(),
                    "points (points, 3), as the first input" if points else "a signal of channels",
                )
            first = lanes[-1].first + lanes[-1].data.shape[1] if lanes else 0
            lanes.append(AlignedInput.empty(port, first, width_of(spec), round(self._distance_s(port, spec) * NS)))
        turns = {port: like_first(port, spec, leader) for port, spec in specs.items()} if points else {}
        object.__setattr__(self, "turns", turns)
        waits = [lane.furthest / NS for lane in (lanes if self.rate_hz else lanes[1:])]
        state = AlignState(lanes, until=NEVER, anchor=NEVER, row=0, missing=0)
        self.set_state(state, delay_s=0.0 if self.method == "hold" else max(waits, default=0.0))
        width = lanes[-1].first + lanes[-1].data.shape[1]
        shape = (width // 3, 3) if points else (width,)
        object.__setattr__(self, "shape", shape)
        units = tuple(spec.units[i % len(spec.units)] for spec in specs.values() for i in range(spec.shape[0]))
        made = StreamSpec(
            shape,
            rate_hz=self.rate_hz or leader.rate_hz,
            channels=joined_names(specs),
            units=leader.units[:1] if points else units,
            settling_s=max(spec.settling_s for spec in specs.values()),
            meta={key: value for key, value in leader.meta.items() if not points or key not in ONE_BODY},
        )
        return {"out": made}

    def _distance_s(self, port: str, spec: StreamSpec) -> float:
        if self.max_distance_s is not None:
            return self.max_distance_s
        if spec.rate_hz is None:
            raise ParameterError("max_distance_s", None, f"given, as input '{port}' is irregular")
        return 1.5 / spec.rate_hz

    def process(self, port: str, chunk: Chunk) -> Emitted:
        state = self.state
        if len(chunk.time):
            next(lane for lane in state.lanes if lane.port == port).take(self._row(port, chunk))
            if state.anchor == NEVER:
                state.anchor = int(chunk.time[0])
        state.until = max(state.until, chunk.until)
        return self._on_grid() if self.rate_hz else self._on_stamps()

    def _row(self, port: str, chunk: Chunk) -> Chunk:
        """The chunk with a sample in a row; points in the first input's axes and unit."""
        if not self.turns:
            return chunk
        turn, data = self.turns[port], chunk.data
        if turn is not None:
            data = data[:, :, turn[0]] * turn[1]
        return Chunk(chunk.time, data.reshape(len(chunk), -1), chunk.until, chunk.lost)

    def close(self) -> Emitted:
        self.state.until = FOREVER
        return self._on_grid() if self.rate_hz else self._on_stamps()

    def _known(self, lanes: list[AlignedInput]) -> int:
        """Rows up to this time can be made: no sample that is still to come counts for them."""
        until = self.state.until
        return until if self.method == "hold" else min((lane.known(until) for lane in lanes), default=until)

    def _on_stamps(self) -> Emitted:
        """Rows at the first stream's stamps, cut where it has lost samples."""
        state = self.state
        leader, *others = state.lanes
        m = int(leader.times.searchsorted(self._known(others), "right"))
        targets, lost = leader.time[:m].copy(), leader.lost[:m].copy()
        out = np.empty((m, state.lanes[-1].first + state.lanes[-1].data.shape[1]))
        out[:, : leader.data.shape[1]] = leader.data[:m]
        leader.drop(m)
        following = min(state.until, int(leader.time[0]) - 1) if leader.count else state.until
        near = np.zeros(m, np.bool_)
        for lane in others:
            if m:
                lane.values(targets, METHODS[self.method], out, near)
            lane.drop_before(following)
        return _pieces(targets, out.reshape(m, *self.shape), lost, following)

    def _on_grid(self) -> Emitted:
        """Rows of the grid at which some stream has a value; the others are counted as lost."""
        state = self.state
        known = self._known(state.lanes)
        targets = self._next_rows(known)
        m = len(targets)
        out = np.empty((m, state.lanes[-1].first + state.lanes[-1].data.shape[1]))
        near = np.zeros(m, np.bool_)
        if m:
            for lane in state.lanes:
                lane.values(targets, METHODS[self.method], out, near)
        rows = np.flatnonzero(near)
        steps = np.diff(rows, prepend=-1) - 1
        if len(rows):
            steps[0] += state.missing
            state.missing = 0
        state.missing += m - (int(rows[-1]) + 1 if len(rows) else 0)
        state.row += m
        return _pieces(targets[rows], out[rows].reshape(len(rows), *self.shape), steps, self._pass(known))

    def _next_rows(self, known: int) -> Times:
        """Stamps of the grid's next rows up to `known`, as far as any sample reaches."""
        reach = max((lane.newest + lane.furthest for lane in self.state.lanes if lane.count), default=NEVER)
        stop = self._row_after(min(known, reach))
        return np.array([self._stamp(row) for row in range(self.state.row, stop)], np.int64)

    def _pass(self, known: int) -> int:
        """Pass over rows up to `known`, where there is nothing; returns up to where the grid is now complete."""
        state = self.state
        if state.anchor == NEVER or known == FOREVER:
            return state.until
        beyond = self._row_after(known)
        state.missing += beyond - state.row
        state.row = beyond
        following = self._stamp(beyond)
        for lane in state.lanes:
            lane.drop_before(following)
        return following - 1

    def _stamp(self, row: int) -> int:
        """The grid's stamp of a row, from its number and the anchor."""
        rate = Fraction(repr(self.rate_hz))
        return self.state.anchor + round(row * NS / rate)

    def _row_after(self, time: int) -> int:
        """The first row later than a time; at least the next one."""
        state = self.state
        if state.anchor == NEVER or time < state.anchor:
            return state.row
        row = max(0, int((time - state.anchor) * Fraction(repr(self.rate_hz)) / NS) - 1)
        while self._stamp(row) <= time:
            row += 1
        return max(row, state.row)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(15)
        emg = StreamSpec((2,), rate_hz=200.0, channels=("a", "b"), units=("uV",))
        accel = StreamSpec((3,), np.dtype(np.float32), 50.0, channels=("x", "y", "z"), units=("g",))
        force = StreamSpec((1,), channels=("a",), units=("N",))
        times = np.sort(rng.integers(10**9, 29 * 10**8, 60))
        inputs: dict[str, tuple[StreamSpec, Array, Array]] = {
            "accel": (accel, grid(50.0, 100), rng.normal(size=(100, 3)).astype(np.float32)),
            "emg": (emg, grid(200.0, 390) + 2_000_000, rng.normal(size=(390, 2))),
            "plate": (force, times, rng.normal(size=(60, 1))),
        }
        regular: dict[str, Any] = {port: inputs[port] for port in ("accel", "emg")}
        return [
            Case(cls(max_distance_s=0.05), inputs, least=100),
            Case(cls(rate_hz=120.0, max_distance_s=0.05, method="nearest"), inputs, least=200),
            Case(cls(method="hold"), regular, least=100),
            Case(cls(rate_hz=100.0), regular, least=150),
            Case(cls(), _two_people(), least=80),
        ]


def _two_people() -> dict[str, Any]:
    """Markers of two people, in other axes and another unit, for trying operators on."""
    rng = np.random.default_rng(16)
    people: dict[str, Any] = {}
    for name, unit, axes, late in (("ann", "m", BODY, 0), ("bob", "cm", CAMERA, 9_000_000)):
        spec = StreamSpec((2, 3), rate_hz=30.0, channels=("hip", "knee"), units=(unit,), meta={"axes": axes.facts()})
        people[name] = (spec, grid(30.0, 90) + late, rng.normal(size=(90, 2, 3)))
    return people


def joined_names(specs: Specs) -> tuple[str, ...]:
    """Channel names side by side; shared ones, and mere numbers, with the input's name before them."""
    names = [(port, name) for port, spec in specs.items() for name in names_of(spec)]
    plain = [name for _, name in names]
    return tuple(name if plain.count(name) == 1 and specs[port].channels else f"{port}.{name}" for port, name in names)


def like_first(port: str, spec: StreamSpec, leader: StreamSpec) -> Turn | None:
    """What makes an input's points those of the first input's axes and unit; None: they are already. Raises InputError."""
    unit, wanted, axes = length_of(spec, port), length_of(leader), Axes.of(leader)
    if bool(unit) != bool(wanted):
        raise InputError(
            port, spec.describe(), f"points in a unit of length, as those of the first input: {wanted or 'no unit'}"
        )
    order, signs = turned_to(axes, spec)
    if (Axes.of(spec) is None) != (axes is None):
        given = describe_axes(spec) or "axes not declared"
        raise InputError(
            port, f"points with {given}", f"points like the first input's: {describe_axes(leader)}; {TURN}"
        )
    size = metres(unit) / metres(wanted)
    return None if order == (0, 1, 2) and signs == (1.0, 1.0, 1.0) and size == 1.0 else (order, size * np.array(signs))


def _pieces(time: Times, data: Samples, lost: Times, until: int) -> Emitted:
    """Chunks that begin where samples are missing."""
    starts = [0, *(int(k) for k in np.flatnonzero(lost) if k)]
    if len(starts) == 1:
        return Chunk(time, data, until, int(lost[0]) if len(lost) else 0)
    whole = Chunk(time, data, until)
    made = [whole.part(a, b) for a, b in zip(starts, [*starts[1:], len(time)], strict=True)]
    for start, piece in zip(starts, made, strict=True):
        piece.lost = int(lost[start])
    return [("out", piece) for piece in made]
