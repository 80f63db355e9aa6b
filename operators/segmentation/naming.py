"""What each repetition is called, by exercises that were shown, and how well it was done: how long, how far, how near to those."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from operators.features.mirror import STACKED
from operators.inputs.channels import names_of
from operators.segmentation.operator import BELIEVED, PRIMITIVE
from operators.segmentation.taught import MOST_LETTERS, UNKNOWN, Taught, taught
from stream.chunk import NEVER, Array, Chunk, Samples, Specs, StreamSpec, Times
from stream.errors import InputError, ParameterError
from stream.operator import Case, Operator, grid
from stream.params import param
from stream.require import numeric, regular, samples_in

TEXT = f"<U{MOST_LETTERS}"
BELIEVED_NAME = np.dtype([("activity", "<i8"), ("repetition", "<i4"), ("name", TEXT), ("sure", "<f8")])
REPETITION = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("activity", "<i8"),
        ("repetition", "<i4"),
        ("cluster", "<i8"),
        ("side", "<i4"),
        ("name", TEXT),
        ("sure", "<f8"),
        ("distance", "<f8"),
        ("duration_s", "<f8"),
        ("range", "<f8"),
        ("moves", TEXT),
    ]
)


@dataclass(slots=True)
class NamingState:
    """frames (ring, features), stamps (ring,): the newest, by number modulo ring; seen: how many have come, (1,); far, cost: room for
    comparing. period: ns. What the names are taken from, and the features' names."""

    frames: Samples
    stamps: Times
    seen: Times
    far: Samples
    cost: Samples
    period: int
    model: Any
    features: list[str]


@dataclass(frozen=True, slots=True)
class NameRepetitions(Operator[NamingState]):
    """Repetitions and the features that they were found in; what each is called, and how it was done, out.

    in           features, as operators.segmentation.Segment takes them
    provisional  of it: repetitions as soon as they are believed
    primitive    of it: repetitions, or their steps, when they are final
    believed     at once: activity, repetition, name, sure (0 to 1)
    repetition   final: onset, end, activity, repetition, cluster, side, as told; name and sure; distance (to the nearest repetition of that
                 name that was shown, in the features' unit; NaN without a model), duration_s, range (of the feature that moves most, in its
                 unit) and moves (which one that is)

    `model` is a file that `kinegraph teach` wrote. What lies too far from all that was shown is "unknown". Without a model clusters
    are named by letters: A, B, ... Two repetitions are compared by warping in time, from whichever phase of the cycle is best.
    A repetition longer than `window_s`, or told later than that, is unknown, and its numbers NaN.
    """

    inputs: ClassVar[tuple[str, ...]] = ("in", "provisional", "primitive")
    optional: ClassVar[tuple[str, ...]] = ("provisional",)
    outputs: ClassVar[tuple[str, ...]] = ("believed", "repetition")

    model: str = param("", help="the exercises that `kinegraph teach` wrote; without: clusters are named by letters")
    window_s: float = param(60.0, above=0.0, most=600.0, help="so much of the features is kept")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        numeric(spec)
        if not spec.is_signal:
            raise InputError(
                "in", spec.describe(), "a signal of features, as operators.segmentation.Segment takes them"
            )
        rate_hz = regular(spec)
        for port, needed in (("provisional", BELIEVED), ("primitive", PRIMITIVE)):
            if port in specs and not set(needed.names or ()) <= set(specs[port].dtype.names or ()):
                raise InputError(
                    port, specs[port].describe(), f"events with the fields {', '.join(needed.names or ())}"
                )
        ring = samples_in("window_s", self.window_s, rate_hz)
        if ring > 20000:
            raise ParameterError("window_s", self.window_s, f"at most {20000 / rate_hz:.4g} s of {rate_hz:g} Hz")
        known = Taught.read(Path(self.model), "in", spec) if self.model else None
        longest = known.frames.shape[1] if known else 0
        self.hold(
            NamingState(
                frames=np.full((ring, spec.shape[0]), np.nan),
                stamps=np.full(ring, NEVER),
                seen=np.zeros(1, np.int64),
                far=np.zeros((3 * longest, longest)),
                cost=np.zeros((2, longest)),
                period=spec.period_ns,
                model=known,
                features=list(names_of(spec)),
            )
        )
        unit = spec.units[0] if len(set(spec.units)) == 1 else ""
        units = {"onset": "ns", "end": "ns", "distance": unit, "range": unit}
        return {
            name: StreamSpec((), dtype, units=tuple(units.get(f, "") for f in dtype.names or ()), meta=spec.meta)
            for name, dtype in (("believed", BELIEVED_NAME), ("repetition", REPETITION))
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        if port == "in":
            for i in range(len(chunk)):
                place = s.seen[0] % len(s.stamps)
                s.frames[place], s.stamps[place] = chunk.data[i], chunk.time[i]
                s.seen[0] += 1
            return []
        rows = chunk.data["repetition"] > 0
        told = chunk.data[rows]
        name, made = ("believed", self._believed(told)) if port == "provisional" else ("repetition", self._final(told))
        return [(name, Chunk(chunk.time[rows].copy(), made, chunk.until, -1 if chunk.lost and len(made) else 0))]

    def _believed(self, told: Array) -> Array:
        made: Array = np.zeros(len(told), BELIEVED_NAME)
        for row, event in zip(made, told, strict=True):
            row["activity"], row["repetition"] = event["activity"], event["repetition"]
            row["name"], _, row["sure"] = self._called(self._span(event), -1)
        return made

    def _final(self, told: Array) -> Array:
        made: Array = np.zeros(len(told), REPETITION)
        for row, event in zip(made, told, strict=True):
            for field in ("onset", "end", "activity", "repetition", "cluster", "side"):
                row[field] = event[field]
            x = self._span(event)
            row["name"], row["distance"], row["sure"] = self._called(x, int(event["cluster"]))
            row["duration_s"] = (event["end"] - event["onset"] + self.state.period) / 1e9
            row["range"], row["moves"] = self._range(x)
        return made

    def _span(self, event: Array) -> Samples:
        """The frames (n, features) from its onset to its end; none, where the first of them has left the window."""
        s = self.state
        newest = int(s.seen[0])
        order = np.arange(max(0, newest - len(s.stamps)), newest) % len(s.stamps)
        stamps = s.stamps[order]
        first, last = np.searchsorted(stamps, [event["onset"], event["end"] + 1])
        if first == last or stamps[first] != event["onset"]:
            return s.frames[:0]
        return s.frames[order[first:last]]

    def _called(self, x: Samples, cluster: int) -> tuple[str, float, float]:
        s = self.state
        if s.model is None:
            return (letters(cluster) if cluster >= 0 else ""), np.nan, 0.0
        if not 0 < len(x) <= len(s.far):
            return UNKNOWN, np.nan, 0.0
        name, distance, sure = s.model.call(s.model.distances(x, s.far, s.cost))
        return name, distance if np.isfinite(distance) else np.nan, sure

    def _range(self, x: Samples) -> tuple[float, str]:
        """How far the feature goes that moves most, and its name."""
        known = np.isfinite(x).any(0) if len(x) else np.zeros(0, bool)
        if not known.any():
            return np.nan, ""
        ranges = np.where(
            known, np.where(np.isfinite(x), x, -np.inf).max(0) - np.where(np.isfinite(x), x, np.inf).min(0), -1.0
        )
        most = int(ranges.argmax())
        return float(ranges[most]), STACKED.sub("", self.state.features[most])[:MOST_LETTERS]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        n = 600
        time, turn = grid(30.0, n), np.arange(n) * 0.2
        x = np.stack([np.sin(turn + k) for k in range(3)], 1)
        spec = StreamSpec((3,), rate_hz=30.0, units=("cm",))
        ends = np.arange(60, n - 40, 30)
        told = np.zeros(len(ends), PRIMITIVE)
        told["onset"], told["end"], told["repetition"] = time[ends - 30], time[ends], np.arange(len(ends)) % 7
        believed = np.zeros(len(ends), BELIEVED)
        for field in ("onset", "end", "repetition"):
            believed[field] = told[field]
        events = {
            "provisional": (StreamSpec((), BELIEVED), time[ends + 5], believed),
            "primitive": (StreamSpec((), PRIMITIVE), time[ends + 30], told),
        }
        inputs = {"in": (spec, time, x), **events}
        path = Path(tempfile.mkdtemp(prefix="kinegraph-")) / "exercises.npz"
        taught([("turn", [x[:31], x[31:62]])], 0.5).write(path, spec, "made up")
        return [Case(cls(model=str(path)), inputs, least=20), Case(cls(window_s=3.0), inputs, least=20)]


def letters(cluster: int) -> str:
    """A, B, ... Z, AA, AB, ..."""
    name, left = "", cluster + 1
    while left:
        left, digit = divmod(left - 1, 26)
        name = chr(ord("A") + digit) + name
    return name
