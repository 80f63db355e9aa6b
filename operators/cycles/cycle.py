"""What a gait cycle is to the operators that make and read cycles: its points, its event, and why one is rejected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.cycles.cycle_kernel import maxima
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import InputError

POINTS = 100
REASONS = (
    "too short", "too long", "gap", "settling", "incomplete", "order", "stance", "irregular", "missing", "quality", "by hand", "contacts",
    "turning",
)  # fmt: skip
"""Why a cycle is rejected, in the order in which it is asked; see `Cycles`."""

CLOSED = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("number", "<i8"),
        ("duration_s", "<f8"),
        ("stance_pct", "<f8"),
        ("cadence", "<f8"),
        ("rejected", "<U12"),
    ]
)
"""A cycle that has ended: from touch-down `onset` to touch-down `end`, the `number`-th since the start (rejected ones counted);
`stance_pct` is when the foot left the ground (NaN: not known); `cadence` is 60 / duration; `rejected` is "" or why it was.
A second event of the same number replaces the first: the cycle was taken back, or is to count after all."""
CLOSED_UNITS = ("ns", "ns", "", "s", "%", "strides/min", "")

MAXIMUM = np.dtype(
    [
        ("onset", "<i8"),
        ("number", "<i8"),
        ("muscle", "<i4"),
        ("name", "<U16"),
        ("position_pct", "<f8"),
        ("height", "<f8"),
    ]
)


@dataclass(frozen=True, slots=True)
class Closing:
    """A cycle at the moment at which it is closed: `curve` (102, c) spans -1..100 %. `again`: its event has been reported before."""

    stamp: int
    onset: int
    end: int
    number: int
    stance_pct: float
    rejected: str
    curve: Samples
    again: bool = False

    def row(self) -> tuple[int, int, int, float, float, float, str]:
        duration = (self.end - self.onset) / NS
        return (self.onset, self.end, self.number, duration, self.stance_pct, 60.0 / duration, self.rejected)

    def maxima(self, names: list[str]) -> Array:
        """An event per local maximum."""
        room = self.curve.shape[1] * POINTS // 2
        place, height = np.empty((room, 2), np.int64), np.empty(room)
        found = maxima(self.curve, place, height)
        rows = np.empty(found, MAXIMUM)
        muscle, at = place[:found, 0], place[:found, 1]
        rows["onset"] = self.onset + (self.end - self.onset) * at // POINTS
        rows["number"], rows["muscle"], rows["position_pct"], rows["height"] = self.number, muscle, at, height[:found]
        rows["name"] = np.array(names)[muscle]
        return rows


@dataclass(slots=True)
class Expected:
    """Accepted cycles that still wait for their sample: the events (128,) and their stamps; the first `waiting` are valid.
    A person may have all of the latest 64 cycles emitted again at once."""

    rows: Array
    stamps: Times
    waiting: int

    @staticmethod
    def empty(kind: np.dtype[Any] = CLOSED) -> Expected:
        return Expected(np.zeros(128, kind), np.zeros(128, np.int64), 0)

    def note(self, chunk: Chunk) -> None:
        """Take a chunk of `closed`; rejected cycles have no sample to wait for."""
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            if not row["rejected"]:
                if self.waiting == len(self.rows):
                    self._drop()
                self.rows[self.waiting], self.stamps[self.waiting] = row, stamp
                self.waiting += 1

    def match(self, stamp: int) -> Array | None:
        """The event (1,) that belongs to a sample of `cycles`; None without one."""
        while self.waiting and self.stamps[0] < stamp:
            self._drop()
        if not self.waiting or self.stamps[0] != stamp:
            return None
        row = self.rows[:1].copy()
        self._drop()
        return row

    def matched(self, cycles: Chunk) -> Iterator[tuple[int, Array, Samples]]:
        """Stamp, event (1,) and curve of each sample in a chunk of `cycles`."""
        for stamp, curve in zip(cycles.time.tolist(), cycles.data, strict=True):
            if (closed := self.match(stamp)) is not None:
                yield stamp, closed, curve

    def heard(self, port: str, chunk: Chunk) -> Iterator[tuple[int, np.void, Samples]]:
        """Events `closed` are noted; of `cycles`, stamp, event and curve of each, in which NaN is what is not a finite number."""
        if port == "closed":
            self.note(chunk)
            return
        for stamp, closed, curve in self.matched(chunk):
            yield stamp, closed[0], only_finite(curve)

    def _drop(self) -> None:
        self.rows[:-1], self.stamps[:-1] = self.rows[1:].copy(), self.stamps[1:].copy()
        self.waiting -= 1


def longest_cycle_s(closed: StreamSpec) -> float:
    """How long a cycle may be (`longest_s` of the node that cuts them); 0: not known."""
    return float(closed.meta.get("longest_s", 0.0))


def is_closed(kind: np.dtype[Any]) -> bool:
    """Whether these are cycles' events: `CLOSED`, or the same with more fields behind (limb, stage)."""
    names = CLOSED.names or ()
    return (kind.names or ())[: len(names)] == names and all(kind[name] == CLOSED[name] for name in names)


def check_cycles(specs: Specs) -> StreamSpec:
    """The spec of input `cycles`, both inputs being those that `Cycles` gives. Raises InputError."""
    cycles, closed = specs["cycles"], specs["closed"]
    if cycles.is_event or len(cycles.shape) != 2 or cycles.shape[0] != POINTS or cycles.channel_axis != 1:
        raise InputError(
            "cycles",
            cycles.describe(),
            f"cycles of {POINTS} points (output 'cycles' of operators.cycles.cycles.Cycles)",
        )
    if not is_closed(closed.dtype):
        raise InputError(
            "closed", closed.describe(), "the cycles' events (output 'closed' of operators.cycles.cycles.Cycles)"
        )
    return cycles


def check_named_cycles(specs: Specs) -> StreamSpec:
    """As `check_cycles`, for what tells channels apart by their names. Raises InputError."""
    cycles = check_cycles(specs)
    if not cycles.channels:
        raise InputError("cycles", f"{cycles.describe()} without channel names", "cycles of channels that have names")
    return cycles


def some_cycles(count: int, muscles: int, seed: int) -> dict[str, tuple[StreamSpec, Array, Array]]:
    """Made-up inputs `closed` and `cycles` for trying operators on: every fifth cycle is rejected, one muscle is missing once, the second
    cycle is taken back with the fourth, and the third comes again, without its first muscle, with the seventh."""
    rng = np.random.default_rng(seed)
    names = ("TA", "SO", "GM", "BF")[:muscles]
    meta = {"side": "right", "normalisation": "mvc"}
    touch = (NS + np.cumsum(1.0 + 0.05 * rng.random(count + 1)) * NS).astype(np.int64)
    closed = np.zeros(count, CLOSED)
    closed["onset"], closed["end"], closed["number"] = touch[:-1], touch[1:], np.arange(1, count + 1)
    closed["duration_s"] = np.diff(touch) / NS
    closed["cadence"] = 60 / closed["duration_s"]
    closed["stance_pct"] = 60 + rng.random(count)
    closed["rejected"][4::5] = "irregular"
    stamps = touch[1:] + 20_000_000
    taken = closed["rejected"] == ""
    phase = np.linspace(0, 2 * np.pi, POINTS, endpoint=False)[:, None]
    curves = 50 + 30 * np.sin(phase + np.arange(muscles)) + 5 * rng.standard_normal((int(taken.sum()), POINTS, muscles))
    curves[2, :, -1] = np.nan
    again = closed[2:3].copy()
    back = closed[1:2].copy()
    back["rejected"] = "irregular"
    closed = np.concatenate([closed[:4], back, closed[4:7], again, closed[7:]])
    stamps = stamps[[0, 1, 2, 3, 3, 4, 5, 6, 6, *range(7, count)]]
    taken = closed["rejected"] == ""
    half = np.where(np.arange(muscles) == 0, np.nan, curves[2])[None]
    curves = np.concatenate([curves[:6], half, curves[6:]])
    spec = StreamSpec((POINTS, muscles), channels=names, units=("% MVC",), channel_axis=1, meta=meta)
    return {
        "closed": (StreamSpec((), CLOSED, units=CLOSED_UNITS, meta=meta), stamps, closed),
        "cycles": (spec, stamps[taken], curves),
    }
