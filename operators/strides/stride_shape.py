"""How each limb strides: how far, how high and in what arch the foot or hoof goes, from its marker and the limb's contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.contacts.limb_contacts import LIMB_CONTACT
from kinegraph.operators.contacts.limbs import LIMB, check_named
from kinegraph.operators.contacts.marker import walker
from kinegraph.operators.cycles.recent_samples import RecentSamples
from kinegraph.operators.inputs.directions import HELP, right_handed_up
from kinegraph.operators.inputs.marker_columns import marker_columns, marker_metres
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

KEPT = 32
STRIDE = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("number", "<i8"),
        ("limb", LIMB),
        ("length_m", "<f8"),
        ("height_m", "<f8"),
        ("arch_pct", "<f8"),
    ]
)
"""A stride of one limb, from touch-down to touch-down: its length, the foot's greatest lift, and the arch of its swing; NaN: not known."""


@dataclass(slots=True)
class StrideState:
    """
    recent             the newest positions, (3 l) m: of each limb both horizontal coordinates, then the vertical one
    touches (l, 32, 3) touch-downs that wait, the first of them the open stride's: onset, stamp, 1 where one may be missing before it
    waiting (l,)       how many of them;  strides (l,): how many there have been;  broken (l,): 1 where the next may have missed one
    lifts (l, 32)      the latest lift-offs, rings;  lifted (l,): in all
    """

    recent: RecentSamples
    columns: Times
    metres: float
    period: int
    touches: Times
    waiting: Times
    strides: Times
    broken: Times
    lifts: Times
    lifted: Times


@dataclass(frozen=True, slots=True)
class StrideShape(Operator[StrideState]):
    """Markers on feet or hooves and the contacts of all limbs (events with a field `limb`) in, one event per stride and limb out.

    length_m  how far the foot has come over the ground, horizontally, from touch-down to the limb's next touch-down
    height_m  how high it is at most between lift-off and touch-down, above its median height in the middle half of the stance before
    arch_pct  the arch of the swing: how far the curve rises above its chord, the straight line from where the foot was at lift-off to where
              it is at touch-down, in % of the chord's length. The rise is square to the chord, in the chord's vertical plane

    Lameness is judged by height, length and arch of the stride (thesis, section 5.2.1), which does not say how they are measured: the
    definitions are ours. A half circle has an arch of 50 %, a foot that is dragged one of 0.

    The ground stands still; with `belt` it moves as the foot does in the middle half of each stance, and length and arch are those over
    the belt. Heights are above the foot's own stance: on a slope, one that goes uphill lifts by the slope, too. Positions are not
    smoothed: noise of the marker adds to height and arch what its highest sample does.

    NaN is whatever is not known: everything where the marker is missing for more than `gap_s` (shorter gaps are filled on a straight
    line; what is not finite, or exactly 0, 0, 0, is missing), where contacts may have been lost, or where the second touch-down came
    later than `late_s`; height and arch, on a belt also the length, where there is not just one lift-off in the stride. A stride longer
    than `longest_s` is skipped. Numbers match those of `operators.cycles.limb_cycles.LimbCycles` for the same contacts: of l limbs, limb i
    has i, i + l, i + 2 l ...

    A stride is emitted `late_s` after its end, when late contacts are there; that is its event's stamp, and the declared delay.

    >>> given, made = tried(StrideShape)
    >>> given["in"].shape, made[["limb", "number"]][0].item(), made["length_m"][0].round(2).item()
    ((1000, 2, 3), ('left', 1), 1.2)
    """

    inputs = {"in": Input(), "touchdown": Input(), "liftoff": Input()}
    delays: ClassVar[str] = "`late_s`"

    limbs: dict[str, str] = param(help="per limb, the marker on its foot: its name, or its number from 0")
    up: Literal["x", "y", "z"] | None = param(None, help=f"{HELP} z")
    unit: Literal["", "m", "cm", "mm"] = param("", help="unit of the positions; empty: the input's")
    belt: bool = param(False, help="whether the ground moves with the standing foot: a treadmill")
    late_s: float = param(0.6, least=0.1, most=5.0, help="how long after it happened a contact may be reported")
    gap_s: float = param(
        0.05, least=0.0, most=1.0, help="a longer gap spoils the stride, a shorter one is interpolated"
    )
    longest_s: float = param(4.0, above=0.0, most=60.0, help="a longer stride is ignored")

    def open(self, specs: Specs) -> Specs:
        spec, touch = specs["in"], specs["touchdown"]
        check_named(specs, ("touchdown", "liftoff"))
        known = [str(name) for name in touch.meta.get("limb_names") or self.limbs]
        if not self.limbs or not set(self.limbs) <= set(known):
            raise ParameterError(
                "limbs", dict(self.limbs), f"limbs of the contacts ({', '.join(known)}), each with its marker"
            )
        if spec.rate_hz is None:
            raise InputError("in", spec.describe(), "regular: its rate must be known")
        vertical = "xyz".index(right_handed_up(spec, self.up, "z", ("x", "y", "z")))
        feet = [marker_columns(spec, marker, "limbs") for marker in self.limbs.values()]
        columns = [foot[(vertical + k) % 3] for foot in feet for k in (1, 2, 3)]
        n = len(feet)
        state = StrideState(
            recent=RecentSamples.of(int((self.longest_s + self.late_s + self.gap_s) * spec.rate_hz * 1.1) + 8, 3 * n),
            columns=np.array(columns),
            metres=marker_metres(spec, columns, self.unit),
            period=spec.period_ns,
            touches=np.zeros((n, KEPT, 3), np.int64),
            waiting=np.zeros(n, np.int64),
            strides=np.zeros(n, np.int64),
            broken=np.zeros(n, np.int64),
            lifts=np.zeros((n, KEPT), np.int64),
            lifted=np.zeros(n, np.int64),
        )
        self.set_state(state, delay_s=self.late_s, decision_s={"out": self.late_s})
        meta = {**touch.meta, "limb_names": list(self.limbs)}
        return {"out": StreamSpec((), STRIDE, units=("ns", "ns", "", "", "m", "m", "%"), meta=meta)}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        if not chunk.lost:
            return [("out", self._taken(port, chunk))]
        before: list[tuple[int, Array]] = []
        self._due(before, int(chunk.time[0]) - 1)
        return [("out", _chunk(before, int(chunk.time[0]) - 1, 0)), ("out", self._taken(port, chunk))]

    def _taken(self, port: str, chunk: Chunk) -> Chunk:
        s, names = self.state, list(self.limbs)
        rows: list[tuple[int, Array]] = []
        if port == "in":
            flat = chunk.data.reshape(len(chunk.data), int(np.prod(chunk.data.shape[1:])))
            for a in range(0, len(chunk.time), s.recent.keep):
                time = chunk.time[a : a + s.recent.keep]
                s.recent.append(time, flat[a : a + s.recent.keep, s.columns] * s.metres)
                self._due(rows, min(int(time[-1]) - 1, chunk.until))
        else:
            if chunk.lost and port == "touchdown":
                s.broken[:] = 1
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                self._due(rows, stamp - 1)
                if str(row["limb"]) in names:
                    self._contact(port, names.index(str(row["limb"])), int(row["onset"]), stamp)
        self._due(rows, chunk.until)
        return _chunk(rows, chunk.until, -1 if chunk.lost else 0)

    def _contact(self, port: str, limb: int, onset: int, stamp: int) -> None:
        s = self.state
        if port == "liftoff":
            s.lifts[limb, s.lifted[limb] % KEPT] = onset
            s.lifted[limb] += 1
            return
        if s.waiting[limb] and onset <= s.touches[limb, s.waiting[limb] - 1, 0]:
            return
        if s.waiting[limb] == KEPT:
            self._next(limb)
        s.touches[limb, s.waiting[limb]] = onset, stamp, s.broken[limb]
        s.waiting[limb] += 1
        s.broken[limb] = 0

    def _next(self, limb: int) -> None:
        s = self.state
        s.touches[limb, :-1] = s.touches[limb, 1:].copy()
        s.waiting[limb] -= 1
        s.strides[limb] += 1

    def _due(self, rows: list[tuple[int, Array]], until: int) -> None:
        """Emit every stride that is due, in order of time, the first limb first."""
        s, late, found = self.state, round(self.late_s * NS), []
        for limb, name in enumerate(self.limbs):
            while s.waiting[limb] > 1:
                start, (end, stamp, broken) = int(s.touches[limb, 0, 0]), s.touches[limb, 1].tolist()
                due = max(stamp, end + late)
                if due > until:
                    break
                row = np.zeros((), STRIDE)
                row["onset"], row["end"], row["limb"] = start, end, name
                row["number"] = s.strides[limb] * len(self.limbs) + limb + 1
                measured = (np.nan,) * 3 if broken or stamp > end + late else self._measure(limb, start, end, due)
                row["length_m"], row["height_m"], row["arch_pct"] = measured
                self._next(limb)
                if end - start <= self.longest_s * NS:
                    found.append((due, row))
        rows += sorted(found, key=lambda each: each[0])

    def _measure(self, limb: int, start: int, end: int, due: int) -> tuple[float, float, float]:
        """Length in m, height in m and arch in % of one stride, by what was there when it was due."""
        s, unknown = self.state, float("nan")
        a, b = s.recent.after(start - s.period - round(self.gap_s * NS) - 1), s.recent.after(due)
        time, place = s.recent.time[a:b], s.recent.data[a:b, 3 * limb : 3 * limb + 3]
        seen = np.isfinite(place).all(axis=1) & (place != 0).any(axis=1)
        time, place = time[seen], place[seen]
        a, b = int(time.searchsorted(start, "right")) - 1, int(time.searchsorted(end, "left")) + 1
        time, place = time[max(a, 0) : b], place[max(a, 0) : b]
        if a < 0 or b - a != len(time) or np.diff(time).max(initial=0) > s.period * 1.5 + self.gap_s * NS:
            return unknown, unknown, unknown
        lifts = [t for t in s.lifts[limb, : min(int(s.lifted[limb]), KEPT)].tolist() if start < t < end]
        if len(lifts) != 1:
            length = _length(_places(time, place, [start, end]))
            return unknown if self.belt else length, unknown, unknown
        stood = lifts[0] - start
        middle = _curve(time, place, start + stood // 4, start + 3 * stood // 4)
        ground = np.zeros(3)
        if self.belt:
            ground[:2] = (middle[-1, :2] - middle[0, :2]) / max(stood // 2, 1)
        swing = _curve(time, place - (time - start)[:, None] * ground, lifts[0], end)
        length = _length(_places(time, place - (time - start)[:, None] * ground, [start, end]))
        return length, float(swing[:, 2].max() - np.median(middle[:, 2])), _arch(swing)

    @classmethod
    def cases(cls) -> list[Case]:
        n, rate_hz = 1000, 100.0
        markers = StreamSpec((2, 3), rate_hz=rate_hz, channels=("L", "R"), units=("m",))
        rows = np.zeros(36, LIMB_CONTACT)
        rows["onset"] = NS + np.arange(36) * (NS // 4) + 1_234_567
        rows["limb"] = np.array(["left", "left", "right", "right"])[np.arange(36) % 4]
        path = walker(n, rate_hz, speed_m_s=1.2, cadence_hz=1.0)[:, [1, 1]]
        spec = StreamSpec((), LIMB_CONTACT, units=("ns", ""), meta={"limb_names": ["left", "right"]})
        stamps = rows["onset"] + 120_000_000
        inputs: dict[str, tuple[StreamSpec, Times, Array]] = {"in": (markers, grid(rate_hz, n), path)}
        for port, k in (("touchdown", 0), ("liftoff", 1)):
            inputs[port] = (spec, stamps[k::2], rows[k::2])
        both = {"left": "L", "right": "R"}
        return [Case(cls(both), inputs, least=14), Case(cls(both, belt=True, late_s=0.1), inputs, least=14)]


def _chunk(rows: list[tuple[int, Array]], until: int, lost: int) -> Chunk:
    return Chunk(np.array([due for due, _ in rows], np.int64), np.array([row for _, row in rows], STRIDE), until, lost)


def _places(time: Times, place: Samples, when: list[int]) -> Samples:
    """Where the foot was (k, 3) at times between its samples."""
    since = (time - time[0]).astype(float)
    return np.stack([np.interp(np.array(when) - time[0], since, place[:, c]) for c in range(3)], axis=1)


def _curve(time: Times, place: Samples, start: int, end: int) -> Samples:
    """The foot's path (k, 3) from `start` to `end`: both ends, and the samples between them."""
    ends = _places(time, place, [start, end])
    return np.concatenate([ends[:1], place[(time > start) & (time < end)], ends[1:]])


def _length(ends: Samples) -> float:
    """The horizontal distance of two places (2, 3)."""
    return float(np.hypot(ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]))


def _arch(swing: Samples) -> float:
    """How far a path (k, 3) rises above its chord, in % of the chord; NaN where the chord has no length, or is upright."""
    forth = np.hypot(*(swing[-1, :2] - swing[0, :2]))
    if forth <= 0.0:
        return float("nan")
    chord = swing[-1] - swing[0]
    size = np.sqrt((chord * chord).sum())
    ahead = chord[:2] / forth
    path = swing - swing[0]
    along = path[:, 0] * ahead[0] + path[:, 1] * ahead[1]
    rise = (path[:, 2] * forth - along * chord[2]) / size
    return float(100.0 * rise.max() / size)
