"""How each stride was walked: straight on, turning, running, shuffling, or coming to a halt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.contacts.limbs import LIMB
from kinegraph.operators.cycles.cycle import is_closed, some_cycles
from kinegraph.operators.inputs.directions import right_handed_up
from kinegraph.stream.chunk import NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

MANNERS = ("walking", "turning", "running", "shuffling", "stopping")
MANNER = np.dtype(
    [("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("limb", LIMB), ("manner", "<U12"), ("turn_deg", "<f8")]
)
"""An accepted cycle, how it was walked, and by how much the body turned in it (to the left; NaN: not known)."""
MANNER_UNITS = ("ns", "ns", "", "", "", "deg")
KEPT_S = 12.0
"""For so long headings are kept: a cycle is reported within less."""
LATEST, ENOUGH = 8, 4
"""A stride is long beside the median of the latest ones, if there are enough of them."""
LEVEL_S = 1.0
"""Over about so long acceleration is averaged for the vertical."""


@dataclass(slots=True)
class StrideMannerState:
    """
    columns   which numbers of a sample are used: of two points their horizontal coordinates, or of a sensor its gyroscope and its
              accelerometer; none without a signal
    ring      (k, 2) the latest headings: sum of turns in rad; `times` (k,) their stamps; `seen` in all
    last      (2,) the newest direction of the hips in rad, and the sum so far
    level     (3,) the mean acceleration
    lengths   (8,) the latest walking strides' durations in s, a ring; `strides` in all
    """

    columns: Times
    is_sensor: bool
    scale: float
    times: Times
    ring: Samples
    seen: int
    last: Samples
    level: Samples
    newest: int
    lengths: Samples
    strides: int


@kernel
def _follow_points(data: Samples, out: Samples, last: Samples) -> None:
    """Sums of turns `out` (n,) of the line between two points, data (n, 4): x, y of the left one, x, y of the right one."""
    for i in range(data.shape[0]):
        across, along = data[i, 1] - data[i, 3], data[i, 0] - data[i, 2]
        if np.isfinite(across) and np.isfinite(along):
            angle = np.arctan2(across, along)
            if np.isfinite(last[0]):
                step = angle - last[0]
                step -= 2.0 * np.pi * np.floor(step / (2.0 * np.pi) + 0.5)
                last[1] += step
            last[0] = angle
        out[i] = last[1]


@kernel
def _follow_sensor(time: Times, newest: int, data: Samples, out: Samples, last: Samples, level: Samples) -> None:
    """The same of a sensor, data (n, 6): speeds of turning in rad/s and acceleration, by its turning about the vertical."""
    before = newest
    for i in range(data.shape[0]):
        seconds = min((time[i] - before) * 1e-9, 0.1) if before > 0 else 0.0
        good = True
        for k in range(6):
            good = good and np.isfinite(data[i, k])
        if good:
            share = seconds / (LEVEL_S + seconds) if level[0] != 0.0 or level[1] != 0.0 or level[2] != 0.0 else 1.0
            size = 0.0
            turn = 0.0
            for k in range(3):
                level[k] += share * (data[i, 3 + k] - level[k])
                size += level[k] * level[k]
                turn += level[k] * data[i, k]
            if size > 0.0:
                last[1] += turn / np.sqrt(size) * seconds
        before = time[i]
        out[i] = last[1]


@dataclass(frozen=True, slots=True)
class StrideManner(Operator[StrideMannerState]):
    """One event per accepted cycle (`MANNER`): walking, turning, running, shuffling or stopping.

    turning    the body turned by `turn_deg` or more between the stride's touch-downs: the line between two markers (`hips`), or an inertial
               sensor anywhere on the body, about the vertical. Not known without a signal
    running    the foot stood for less than half of the stride
    shuffling  it stood for `shuffle_pct` of it or more
    stopping   the stride took `stop_ratio` times as long as the median of the latest ones, or more: the first or last before standing

    `CycleReview` (input `manner`) leaves strides of turning out, unless asked for with `count_turns`.

    >>> given, made = tried(StrideManner)
    >>> made["manner"].tolist().count("turning")
    2
    """

    inputs = {"signal": Input(optional=True), "closed": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("manner",)

    hips: tuple[str, ...] = param((), help="two markers, the left and the right one, if the signal holds markers")
    turn_deg: float = param(
        20.0, above=0.0, most=180.0, help="a stride that turns the body by this angle is one of turning"
    )
    shuffle_pct: float = param(
        75.0, above=50.0, most=100.0, help="a foot that stands for this share of the stride shuffles"
    )
    stop_ratio: float = param(
        1.35, above=1.0, help="a stride that takes this multiple of the usual time is one of stopping"
    )

    def open(self, specs: Specs) -> Specs:
        closed = specs["closed"]
        if not is_closed(closed.dtype):
            raise InputError("closed", closed.describe(), "cycles' events (operators.cycles.cycles.Cycles)")
        columns, is_sensor, scale, kept = np.empty(0, np.int64), False, 1.0, 1
        if (spec := specs.get("signal")) is not None:
            columns, is_sensor, scale = self._columns(spec)
            kept = round(KEPT_S * (spec.rate_hz or 1000.0)) + 1
        self.set_state(
            StrideMannerState(
                columns, is_sensor, scale, np.full(kept, NEVER), np.zeros(kept), 0, np.array([np.nan, 0.0]), np.zeros(3), NEVER,
                np.zeros(LATEST), 0,
            ),
            decision_s={"manner": 0.0},
        )  # fmt: skip
        return {"manner": StreamSpec((), MANNER, units=MANNER_UNITS, meta=closed.meta)}

    def _columns(self, spec: StreamSpec) -> tuple[Times, bool, float]:
        """Which numbers of a sample are used, whether they are a sensor's, and the factor of its speeds to rad/s."""
        if spec.dtype.kind == "f" and len(spec.shape) == 2 and spec.shape[1] == 3:
            if len(self.hips) != 2:
                raise ParameterError("hips", list(self.hips), "the names of two markers: the left and the right one")
            for name in self.hips:
                if name not in spec.channels:
                    raise ParameterError("hips", name, f"a marker of the signal; {nearest(name, spec.channels)}")
            up = "xyz".index(right_handed_up(spec, None, "z", ("x", "y", "z")))
            first, second = (up + 1) % 3, (up + 2) % 3
            left, right = (3 * spec.channels.index(name) for name in self.hips)
            return np.array([left + first, left + second, right + first, right + second]), False, 1.0
        units = spec.units if spec.is_signal and len(spec.units) == spec.shape[0] else ()
        turns = [i for i, unit in enumerate(units) if unit in ("deg/s", "rad/s")][:3]
        pulls = [i for i, unit in enumerate(units) if unit in ("g", "m/s2", "m/s^2")][:3]
        if len(turns) < 3 or len(pulls) < 3:
            raise InputError(
                "signal",
                spec.describe(),
                "markers, or a sensor's speeds in deg/s or rad/s and acceleration in g or m/s2",
            )
        return np.array(turns + pulls), True, np.pi / 180 if units[turns[0]] == "deg/s" else 1.0

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        if port == "signal":
            self._follow(chunk)
            return [("manner", Chunk(np.empty(0, np.int64), np.empty(0, MANNER), chunk.until))]
        rows = [
            (stamp, self._row(row))
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True)
            if not row["rejected"]
        ]
        stamps = np.array([stamp for stamp, _ in rows], np.int64)
        made = np.array([row for _, row in rows], MANNER)
        return [("manner", Chunk(stamps, made, chunk.until, -1 if chunk.lost else 0))]

    @classmethod
    def cases(cls) -> list[Case]:
        closed = some_cycles(14, 2, 3)["closed"]
        time = grid(50.0, 50 * 18)
        angle = np.where(time < closed[2]["onset"][6], 0.0, np.minimum(2.0, (time - closed[2]["onset"][6]) / NS))
        left = np.stack([np.cos(angle), np.sin(angle), 1 + 0 * angle], axis=1)
        points = np.stack([left, -left], axis=1)
        points[300:310] = np.nan
        spec = StreamSpec((2, 3), rate_hz=50.0, channels=("LHIP", "RHIP"), units=("m",))
        units = ("rad/s",) * 3 + ("m/s2",) * 3
        sensor = np.column_stack([np.zeros((900, 2)), np.gradient(angle, 0.02), np.zeros((900, 2)), np.full(900, 9.81)])
        board = StreamSpec((6,), rate_hz=50.0, channels=("gx", "gy", "gz", "ax", "ay", "az"), units=units)
        return [
            Case(cls(hips=("LHIP", "RHIP")), {"signal": (spec, time, points), "closed": closed}, least=8),
            Case(cls(), {"signal": (board, time, sensor), "closed": closed}, least=8),
            Case(cls(), {"closed": closed}, least=8),
        ]

    def _follow(self, chunk: Chunk) -> None:
        s, n = self.state, len(chunk.time)
        if not n:
            return
        data = np.ascontiguousarray(chunk.data.reshape(n, -1)[:, s.columns], np.float64)
        sums = np.empty(n)
        if s.is_sensor:
            data[:, :3] *= s.scale
            _follow_sensor(chunk.time, s.newest, data, sums, s.last, s.level)
        else:
            _follow_points(data, sums, s.last)
        s.newest = int(chunk.time[-1])
        place = (s.seen + np.arange(n)) % len(s.times)
        kept = slice(max(0, n - len(s.times)), None)
        s.times[place[kept]], s.ring[place[kept]] = chunk.time[kept], sums[kept]
        s.seen += n

    def _row(self, row: np.void) -> tuple[int, int, int, str, str, float]:
        s, onset, end = self.state, int(row["onset"]), int(row["end"])
        turn = self._turned(onset, end)
        manner = self._manner(turn, float(row["stance_pct"]), (end - onset) / NS)
        limb = str(row["limb"]) if "limb" in (row.dtype.names or ()) else ""
        if manner == "walking":
            s.lengths[s.strides % LATEST] = (end - onset) / NS
            s.strides += 1
        return onset, end, int(row["number"]), limb, manner, turn

    def _turned(self, onset: int, end: int) -> float:
        """By how many degrees the body turned from one stamp to another; NaN where that is not known."""
        s = self.state
        count = min(s.seen, len(s.times))
        if not count:
            return np.nan
        order = (s.seen - count + np.arange(count)) % len(s.times)
        times, sums = s.times[order], s.ring[order]
        if onset < times[0] or end > times[-1]:
            return np.nan
        first, last = np.searchsorted(times, [onset, end])
        return float(np.degrees(sums[last] - sums[first]))

    def _manner(self, turn_deg: float, stance_pct: float, seconds: float) -> str:
        s = self.state
        if abs(turn_deg) >= self.turn_deg:
            return "turning"
        if stance_pct < 50.0:
            return "running"
        if stance_pct >= self.shuffle_pct:
            return "shuffling"
        known = s.lengths[: min(s.strides, LATEST)]
        if len(known) >= ENOUGH and seconds >= self.stop_ratio * float(np.median(known)):
            return "stopping"
        return "walking"
