"""Footfalls of two legs or four: each limb's phase and duty factor in every stride, support, and the gait by its name."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from kinegraph.operators.contacts.limbs import LIMB, check_named
from kinegraph.operators.cycles.limb_cycles import some_hooves, some_limbs
from kinegraph.operators.strides.gait_name import gait_name
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

KEPT = 32
EDGE = 0.125
"""So near to a stride's ends, in strides, a touch-down may fall out of it."""
WHEN = [("onset", "<i8"), ("end", "<i8"), ("number", "<i8")]
FOOTFALL = np.dtype([*WHEN, ("limb", LIMB), ("phase_pct", "<f8"), ("duty_pct", "<f8")])
"""A limb in a stride of the reference limb: when it touched down, and for how much of the stride it stood."""
GAIT = np.dtype(
    [
        *WHEN,
        ("gait", "<U16"),
        ("stride_s", "<f8"),
        ("double_support_pct", "<f8"),
        ("flight_pct", "<f8"),
        ("feet", "<f8"),
        ("least_sure_pct", "<f8"),
    ]
)
"""A stride: its gait, how long two or more feet, or no foot, stood, and the mean number of feet; `least_sure_pct` is how far the phase
or duty factor that lies nearest to a limit of the gait lies from it."""


@dataclass(slots=True)
class FootfallState:
    """
    contacts (l, 2, 32)   the latest touch-downs and lift-offs of each limb, rings; seen (l, 2): in all
    strides (32, 2)       touch-downs of the reference limb, onset and stamp, of which `waiting` wait;  number: of the stride under way
    broken                contacts may have been missed since the last stride
    """

    names: list[str]
    contacts: Times
    seen: Times
    strides: Times
    waiting: int
    number: int
    broken: int


@dataclass(frozen=True, slots=True)
class Footfalls(Operator[FootfallState]):
    """Contacts of all limbs in (events with a field `limb`), for every stride of the reference limb two kinds of events out.

    limbs   one per limb: `phase_pct`, when in the stride it touched down (the reference: 0), and `duty_pct`, for how much of the stride it
            stood. NaN where it did not touch down just once
    gait    the gait's name, double support, flight, the mean number of feet on the ground

    Named is, of limbs called left and right: walk (no flight, double support), run (flight). Of left hind, right hind, left fore and right
    fore, after Hildebrand (Science 150, 1965): hind feet and fore feet each half a stride apart within `tolerance_pct` is a symmetrical
    gait: by the phase of a fore foot after the hind foot of its side pace (0 or 100 %), trot (50 %), walk (25 or 75 %, with a duty factor
    above 50 %); a quarter of the stride apart or less in both pairs, with a duty factor below 50 %, is gallop. Everything else, limbs of
    other names, and what lies within 2 % of a limit is "unknown".

    A stride is reported `late_s` after its end, when late contacts are there; that is its events' stamp, and the declared delay.

    >>> given, made = tried(Footfalls)
    >>> len(given["touchdown"]), made["gait"][["gait", "stride_s"]][0].item()
    (26, ('walk', 1.098835007))
    """

    inputs = {"touchdown": Input(), "liftoff": Input()}
    outputs: ClassVar[tuple[str, ...]] = ("limbs", "gait")

    reference: str = param("", help="the limb that defines strides; empty: the first")
    late_s: float = param(0.4, least=0.0, most=5.0, help="how long after it happened a contact may be reported")
    tolerance_pct: float = param(12.5, above=0.0, most=25.0, help="how far feet of a pair may be off half a stride")
    longest_s: float = param(4.0, above=0.0, most=60.0, help="a longer stride is ignored")

    def open(self, specs: Specs) -> Specs:
        check_named(specs, self.inputs)
        names = [str(name) for name in specs["touchdown"].meta.get("limb_names") or ()]
        if len(names) < 2:
            raise InputError("touchdown", specs["touchdown"].describe(), "contacts of two limbs or more")
        if self.reference and self.reference not in names:
            raise ParameterError("reference", self.reference, f"one of the limbs; {nearest(self.reference, names)}")
        state = FootfallState(
            names, np.zeros((len(names), 2, KEPT), np.int64), np.zeros((len(names), 2), np.int64),
            np.zeros((KEPT, 2), np.int64), 0, 0, 0,
        )  # fmt: skip
        self.set_state(state, delay_s=self.late_s, decision_s={"limbs": self.late_s, "gait": self.late_s})
        when, meta = ("ns", "ns", ""), specs["touchdown"].meta
        return {
            "limbs": StreamSpec((), FOOTFALL, units=(*when, "", "%", "%"), meta=meta),
            "gait": StreamSpec((), GAIT, units=(*when, "", "s", "%", "%", "", "%"), meta=meta),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s, k = self.state, [*self.inputs].index(port)
        first = s.names.index(self.reference) if self.reference else 0
        found: list[tuple[int, Array, Array]] = []
        for i, (stamp, row) in enumerate(zip(chunk.time.tolist(), chunk.data, strict=True)):
            self._due(found, stamp - 1)
            s.broken = 1 if i == 0 and chunk.lost else s.broken
            if str(row["limb"]) in s.names:
                limb = s.names.index(str(row["limb"]))
                s.contacts[limb, k, s.seen[limb, k] % KEPT] = row["onset"]
                s.seen[limb, k] += 1
                if limb == first and k == 0:
                    self._stride(int(row["onset"]), stamp)
        self._due(found, chunk.until)
        lost = -1 if chunk.lost else 0
        stamps = np.array([stamp for stamp, *_ in found], np.int64)
        limbs = np.concatenate([np.empty(0, FOOTFALL), *(rows for _, rows, _ in found)])
        gaits = np.concatenate([np.empty(0, GAIT), *(row for *_, row in found)])
        return [
            ("limbs", Chunk(stamps.repeat(len(s.names)), limbs, chunk.until, lost)),
            ("gait", Chunk(stamps, gaits, chunk.until, lost)),
        ]

    @classmethod
    def cases(cls) -> list[Case]:
        made = some_limbs(8)
        inputs = {port: made[port] for port in cls.inputs}
        return [
            Case(cls(), inputs, least=30),
            Case(cls(reference="right", late_s=0.1), inputs, least=30),
            Case(cls(reference="left hind", tolerance_pct=20.0), some_hooves(36), least=100),
        ]

    def _stride(self, onset: int, stamp: int) -> None:
        """The reference limb has touched down."""
        s = self.state
        if s.waiting and onset <= s.strides[s.waiting - 1, 0]:
            return
        if s.waiting == KEPT:
            s.strides[:-1] = s.strides[1:].copy()
            s.waiting -= 1
        s.strides[s.waiting] = onset, stamp
        s.waiting += 1

    def _due(self, found: list[tuple[int, Array, Array]], until: int) -> None:
        """Emit every stride that is due."""
        s, late = self.state, round(self.late_s * NS)
        while s.waiting > 1:
            start, end = int(s.strides[0, 0]), int(s.strides[1, 0])
            due = max(int(s.strides[1, 1]), end + late)
            if due > until:
                return
            s.strides[:-1] = s.strides[1:].copy()
            s.waiting -= 1
            s.number += 1
            if end - start <= self.longest_s * NS:
                found.append((due, *self._rows(start, end)))
            s.broken = 0

    def _rows(self, start: int, end: int) -> tuple[Array, Array]:
        s, duration = self.state, end - start
        limbs, gait = np.zeros(len(s.names), FOOTFALL), np.zeros(1, GAIT)
        for rows in (limbs, gait):
            rows["onset"], rows["end"], rows["number"] = start, end, s.number
        stands = [self._stands(i, start, end) for i in range(len(s.names))]
        limbs["limb"] = s.names
        for i, (phase, spans) in enumerate(stands):
            limbs["phase_pct"][i] = phase
            limbs["duty_pct"][i] = 100 * sum(b - a for a, b in spans) / duration if spans else np.nan
        feet = _feet([spans for _, spans in stands], start, end)
        known = np.isfinite(limbs["duty_pct"]).all()
        gait["stride_s"] = duration / NS
        for name, value in (
            ("double_support_pct", 100 * feet[2:].sum()),
            ("flight_pct", 100 * feet[0]),
            ("feet", float(np.arange(len(feet)) @ feet)),
        ):
            gait[name] = value if known else np.nan
        found = ("unknown", 0.0)
        if known and not s.broken:
            found = gait_name(s.names, limbs["phase_pct"], limbs["duty_pct"], float(100 * feet[0]), self.tolerance_pct)
        gait["gait"], gait["least_sure_pct"] = found
        return limbs, gait

    def _stands(self, limb: int, start: int, end: int) -> tuple[float, list[tuple[int, int]]]:
        """When in the stride, in %, the limb touched down (NaN: not just once), and from when to when it stood."""
        s = self.state
        downs, ups = (np.sort(s.contacts[limb, k, : min(int(s.seen[limb, k]), KEPT)]) for k in (0, 1))
        phase = _phase((downs - start) / (end - start))
        events = sorted([(int(t), 1) for t in downs if t < end] + [(int(t), 0) for t in ups if t < end])
        before = [kind for t, kind in events if t <= start]
        inside = [(t, kind) for t, kind in events if t > start]
        if not before and not inside:
            return phase, []
        down = before[-1] if before else 1 - inside[0][1]
        spans, since = [], start
        for t, kind in [*inside, (end, 0)]:
            if down and not kind:
                spans.append((since, t))
            since = t if kind and not down else since
            down = kind
        return phase, spans


def _phase(places: Samples) -> float:
    """The phase in % of touch-downs at these places of a stride (0..1); NaN where there was not just one.

    A limb that comes down with the reference limb may do so twice in a stride, at both ends, or just before it and just after.
    """
    here = places[(places >= 0) & (places < 1)]
    if len(here) == 2 and here[1] - here[0] > 1 - EDGE:
        here = here[:1]
    if not len(here):
        near = places[(places >= -EDGE) & (places < 1 + EDGE)]
        here = near[:1] % 1.0
    return float(100 * here[0]) if len(here) == 1 else float("nan")


def _feet(stands: list[list[tuple[int, int]]], start: int, end: int) -> Samples:
    """For which part of the time (l + 1,) 0, 1, ... feet stood."""
    parts = np.zeros(len(stands) + 1)
    edges = sorted({start, end, *(t for spans in stands for span in spans for t in span)})
    for a, b in pairwise(edges):
        parts[sum(any(x <= a and b <= y for x, y in spans) for spans in stands)] += b - a
    return parts / (end - start)
