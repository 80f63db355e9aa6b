"""Biofeedback: the last cycle of a muscle against a target band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from kinegraph.operators.cycles.cycle import POINTS, Expected, check_cycles, some_cycles
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import ParameterError, nearest
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

TARGET = np.dtype(
    [
        ("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("name", "<U16"), ("from_pct", "<f8"), ("to_pct", "<f8"), ("value", "<f8"),
        ("low", "<f8"), ("high", "<f8"), ("state", "<U8"), ("hits", "<i8"), ("cycles", "<i8"),
    ]
)  # fmt: skip
"""A cycle against a target: below, within or above its band; how many of the cycles so far were within."""


@dataclass(frozen=True, slots=True)
class TargetBand:
    """A muscle's mean or peak between two points of the cycle shall lie between `low` and `high`, in the cycles' unit. A phase with
    `to_pct` below `from_pct` runs over the touch-down."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    muscle: str = param(help="the muscle")
    low: float = param(help="the band's lower end, in the cycles' unit")
    high: float = param(help="its upper end")
    from_pct: float = param(0.0, least=0.0, most=100.0, help="where the phase begins")
    to_pct: float = param(100.0, least=0.0, most=100.0, help="where it ends")
    measure: Literal["mean", "peak"] = param("mean", help="what of the muscle counts there")


@dataclass(slots=True)
class TargetsState:
    """hits, cycles (t,): how often each target was met, and tried;  places (t,) of the muscles;  values (t,) the latest."""

    expected: Expected
    hits: Array
    cycles: Array
    places: Array
    values: Samples


@dataclass(frozen=True, slots=True)
class CycleTargets(Operator[TargetsState]):
    """Cycles and their events in; after every accepted cycle, how it stands to each target.

    targets  one event per target with its muscle in the cycle (`TARGET`)
    values   (targets,) the latest value of each target, for a listener (LSL, OSC); NaN until there is one

    Reported with the cycle: as late after its closing touch-down as `check` says. One reported again (a person left it out) comes as
    it is then, and counts twice.

    >>> targets = [TargetBand(muscle="TA", low=40.0, high=60.0)]
    >>> made = apply(CycleTargets(targets=targets), **some_cycles(8, 1, seed=1))["values"]
    >>> made[:2].round(1).tolist()
    [[49.6], [49.5]]
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("targets", "values")

    targets: tuple[TargetBand, ...] = param(help="{muscle: TA, from_pct: 60, to_pct: 85, low: 40, high: 80}")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        for target in self.targets:
            if target.muscle not in spec.channels:
                raise ParameterError("targets", target.muscle, f"a muscle; {nearest(target.muscle, spec.channels)}")
            if target.low >= target.high:
                raise ParameterError("targets", target.low, f"low below high ({target.high:g})")
        names = tuple(f"{t.muscle} {t.measure} {t.from_pct:g}-{t.to_pct:g} %" for t in self.targets)
        if not names or len(set(names)) < len(names):
            raise ParameterError("targets", names, "at least one target, each muscle and phase once")
        n = len(names)
        places = np.array([spec.channels.index(t.muscle) for t in self.targets])
        expected = Expected.empty(specs["closed"].dtype)
        self.set_state(
            TargetsState(expected, np.zeros(n, np.int64), np.zeros(n, np.int64), places, np.full(n, np.nan)),
            decision_s={"targets": 0.0},
        )
        unit = spec.units[0] if len(spec.units) == 1 else ""
        units = ("ns", "ns", "", "", "%", "%", unit, unit, unit, "", "", "")
        return {
            "targets": StreamSpec((), TARGET, units=units, meta=spec.meta),
            "values": StreamSpec((n,), channels=names, units=(unit,), meta=spec.meta),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        made: list[tuple[int, Array, Samples]] = []
        if port == "closed":
            s.expected.note(chunk)
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                targets = self._rows(closed[0], only_finite(curve))
                made.append((stamp, targets, s.values.copy()))
        made = [one for one in made if len(one[1])]
        lost, stamps = -1 if chunk.lost else 0, np.array([stamp for stamp, *_ in made], np.int64)
        rows = [rows for _, rows, _ in made]
        values = np.array([v for *_, v in made]).reshape(-1, len(s.values))
        return [
            (
                "targets",
                Chunk(
                    stamps.repeat([len(r) for r in rows]),
                    np.concatenate([np.empty(0, TARGET), *rows]),
                    chunk.until,
                    lost,
                ),
            ),
            ("values", Chunk(stamps, values, chunk.until, lost)),
        ]

    @classmethod
    def cases(cls) -> list[Case]:
        two = (TargetBand("TA", 40.0, 60.0, 10.0, 40.0), TargetBand("SO", 70.0, 90.0, 90.0, 10.0, "peak"))
        return [
            Case(cls(two), some_cycles(20, 3, 5), least=40),
            Case(cls(two[:1]), some_cycles(20, 2, 6), least=20),
        ]

    def _rows(self, closed: np.void, curve: Samples) -> Array:
        s, rows = self.state, np.zeros(len(self.targets), TARGET)
        points = np.arange(POINTS) * (100 / POINTS)
        for k, (row, target) in enumerate(zip(rows, self.targets, strict=True)):
            a, b = target.from_pct, target.to_pct
            inside = (points >= a) & (points < b) if a < b else (points >= a) | (points < b)
            part = curve[inside, int(s.places[k])]
            value = float(part.mean() if target.measure == "mean" else part.max()) if len(part) else np.nan
            for name in ("onset", "end", "number"):
                row[name] = closed[name]
            row["name"], row["from_pct"], row["to_pct"], row["low"], row["high"] = (
                target.muscle,
                a,
                b,
                target.low,
                target.high,
            )
            row["value"] = value
            if np.isfinite(value):
                row["state"] = "below" if value < target.low else "above" if value > target.high else "within"
                s.values[k] = value
                s.cycles[k] += 1
                s.hits[k] += row["state"] == "within"
            row["hits"], row["cycles"] = s.hits[k], s.cycles[k]
        return np.asarray(rows[np.isfinite(rows["value"])])
