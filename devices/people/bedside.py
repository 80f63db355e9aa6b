"""Nights in a simulated bedroom as a source: depth frames and what really happened, at the pace that is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import isfinite
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from kinegraph.devices.people import bedroom
from kinegraph.devices.people.bedroom import Bedroom, Extras
from kinegraph.devices.people.night import EPOCH_S, NightPlan, made_up, plan
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec, empty
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

TRUTH = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("sleeper", "<i8"),
        ("stage", "U2"),
        ("moved_s", "<f8"),
        ("in_bed_s", "<f8"),
        ("breaths", "<f8"),
    ]
)
"""What happened in an epoch: the sleeper's number, stage, seconds with movement, seconds in bed, breaths per minute."""
LONGEST_S = 24 * 3600
STAGES = {"0": "W", "1": "N1", "2": "N2", "3": "N3", "4": "N3", "5": "R", "wake": "W", "rem": "R"}
STAGES |= {name.lower(): name for name in ("W", "N1", "N2", "N3", "R")} | dict.fromkeys(("?", "-1", "unknown"), "W")
"""What stages are called, in small letters; one that was not scored is shown awake."""
TOGETHER = 8
"""Frames in a chunk when it goes faster than time."""


@dataclass(frozen=True, slots=True)
class Bedside(Source):
    """A simulated depth camera over a bed, for one night along a hypnogram.

    depth  (height, width) uint16, mm, 0: no measurement; as devices.oak.Oak gives it
    truth  an event per epoch and sleeper, at the epoch's end: what really happened

    The hypnogram is made up, or read from a CSV with the columns `onset` (s) and `stage` (W N1 N2 N3 R, or 0 1 2 3 5). Everything else is
    made up along it (devices/people/night.py): it tests what is done with frames, and shows nothing about sleep.

    With `evening` the night begins at that time of day (UTC), the next one to come; a source that is opened again in the middle of the
    night goes on with it, as a camera does that was unplugged. Without, it begins when it is opened.
    """

    outputs: ClassVar[tuple[str, ...]] = ("depth", "truth")

    width: int = param(160, least=16, most=4096, help="pixels in a row of a frame")
    height: int = param(120, least=16, most=4096, help="rows of a frame")
    fps: float = param(2.0, above=0.0, most=240.0, help="frames per second of the night")
    speed: float = param(0.0, least=0.0, help="how many times real time; 0: as fast as the graph takes it")
    bed_h: float = param(8.0, above=0.0, most=24.0, help="time in bed of a made-up hypnogram")
    hypnogram: str = param("", help="a CSV with onset and stage; left out: one is made up")
    evening: str = param("", help="when the night begins, HH:MM UTC; left out: at once")
    evening_min: float = param(5.0, least=2.0, help="how long the bed is empty before")
    morning_min: float = param(5.0, least=0.0, help="and afterwards")
    exits: int = param(2, least=0, help="how often the sleeper gets up at night")
    sleepers: int = param(1, least=1, most=2, help="how many lie in the bed")
    pet: bool = param(True, help="a cat walks by, and lies on the bed for ten minutes")
    lamp: bool = param(True, help="a lamp disturbs the camera while the bed is empty")
    invalid: float = param(0.1, least=0.0, most=1.0, help="share of pixels without a measurement")
    seed: int = param(0, least=0, help="another seed, another night")
    drift_ppm: float = param(
        0.0, least=-1000, most=1000, help="how much too fast the camera's clock goes, in millionths"
    )
    faults: tuple[tuple[Literal["frozen", "blind", "gone"], float, float], ...] = param(
        (), help="what goes wrong: [frozen, blind or gone, from (s), for (s)]"
    )

    @property
    def live(self) -> bool:
        return self.speed > 0

    @property
    def chunk_s(self) -> float:
        return (1 if self.live else TOGETHER) / self.fps

    def specs(self) -> Specs:
        if self.evening:
            _clock(self.evening)
        if self.hypnogram:
            try:
                read_stages(Path(self.hypnogram))
            except DeviceError as error:
                raise ParameterError("hypnogram", self.hypnogram, f"a hypnogram: {error}") from None
        meta = {"device": "simulated bedroom", "invalid": 0, "simulated": True}
        shape = (self.height, self.width)
        units = ("ns", "ns", "", "", "s", "s", "1/min")
        return {
            "depth": StreamSpec(shape, np.dtype(np.uint16), rate_hz=self.fps, units=("mm",), meta=meta),
            "truth": StreamSpec((), TRUTH, units=units, meta=meta),
        }

    def plans(self) -> tuple[NightPlan, ...]:
        """What happens, per sleeper."""
        stages = read_stages(Path(self.hypnogram)) if self.hypnogram else None
        return tuple(
            plan(
                stages or made_up(self.bed_h, self.seed + k),
                evening_s=60 * self.evening_min + 40 * k,
                morning_s=60 * self.morning_min,
                exits=self.exits,
                seed=self.seed + k,
            )
            for k in range(self.sleepers)
        )

    def prepare(self) -> None:
        bedroom.prepare()

    def read(self, feed: Feed) -> None:
        plans = self.plans()
        room = Bedroom(self.width, self.height, plans, extras=Extras(self.pet, self.lamp, self.invalid), seed=self.seed)
        now = feed.now()
        length_s = max(p.length_s for p in plans)
        begun = _evening(self.evening, now, length_s) if self.evening else self._next_epoch(now)
        _Night(self, room, feed, begun, now).run(length_s)

    def _next_epoch(self, now: int) -> int:
        """A boundary of epochs (ns) near `now`: the next one; in real time the last one, as no stamp may lie ahead of the clock."""
        epoch = round(EPOCH_S * NS)
        return now // epoch * epoch if self.live else -(-now // epoch) * epoch


class _Night:
    """One opening: frames and truth from now to the end of the night that began at `begun` (ns)."""

    def __init__(self, of: Bedside, room: Bedroom, feed: Feed, begun: int, now: int) -> None:
        self._of, self._room, self._feed, self._begun, self._opened = of, room, feed, begun, now
        specs = of.specs()
        self._depth, self._truth = specs["depth"], specs["truth"]
        self._moved = [p.moved_s() for p in room.plans]
        self._held: tuple[float, np.ndarray] | None = None

    def run(self, length_s: float) -> None:
        of, feed = self._of, self._feed
        first = max(0, -(-(self._opened - self._begun) * round(of.fps * 1000) // (1000 * NS)))
        last = int(length_s * of.fps)
        size = 1 if of.live else TOGETHER
        epoch = int(first / of.fps // EPOCH_S)
        lost = 0
        feed.ready()
        for k in range(first, last, size):
            seconds = [i / of.fps for i in range(k, min(k + size, last))]
            stamps = np.array([self._begun + round(s * (1 + of.drift_ppm * 1e-6) * NS) for s in seconds])
            ahead = (seconds[-1] - first / of.fps) / of.speed if of.live else 0.0
            if ahead and feed.wait(max(0.0, ahead - (feed.now() - self._opened) / NS)):
                return
            if feed.stopped:
                return
            there = [i for i, s in enumerate(seconds) if self._fault(s) != "gone"]
            until = int(stamps[-1])
            if there:
                frames = np.stack([self._frame(k + i, seconds[i]) for i in there])
                feed.emit(Chunk(stamps[there], frames, until, lost), "depth")
                lost = 0
            else:
                feed.emit(empty(self._depth, until), "depth")
            lost += len(seconds) - len(there)
            while (epoch + 1) * EPOCH_S <= seconds[-1]:
                self._emit(epoch, until)
                epoch += 1
            feed.emit(empty(self._truth, until), "truth")

    def _fault(self, seconds: float) -> str:
        return next((what for what, begin, length in self._of.faults if begin <= seconds < begin + length), "")

    def _frame(self, index: int, seconds: float) -> np.ndarray:
        fault = self._fault(seconds)
        if fault == "frozen" and self._held is not None:
            return self._held[1]
        frame = self._room.frame(index, seconds)
        if fault == "blind":
            return np.zeros_like(frame)
        self._held = seconds, frame
        return frame

    def _emit(self, epoch: int, stamp: int) -> None:
        rows = []
        begin, end = epoch * EPOCH_S, (epoch + 1) * EPOCH_S
        for k, night in enumerate(self._room.plans):
            there = EPOCH_S - sum(max(0.0, min(b, end) - max(a, begin)) for a, b in night.absent)
            moved = float(self._moved[k][epoch]) if epoch < len(self._moved[k]) else 0.0
            breaths = night.breaths_per_min(begin, end) if there else float("nan")
            times = self._begun + round(begin * NS), self._begun + round(end * NS)
            rows.append((*times, k, night.stage(begin), moved, there, breaths))
        feed = self._feed
        feed.emit(Chunk(np.full(len(rows), stamp), np.array(rows, TRUTH), stamp), "truth")


def read_stages(path: Path) -> tuple[str, ...]:
    """The stages of a CSV with the columns onset (s) and stage, one per 30 s. Raises DeviceError, which names the line."""
    found: list[tuple[float, str]] = []
    for line, row in read_records(path, DeviceError):
        try:
            onset, stage = float(row["onset"]), STAGES[row["stage"].strip().lower()]
        except (KeyError, ValueError, AttributeError):
            text = ",".join(str(value) for value in row.values())
            raise DeviceError(
                f"{path}, line {line}: {text!r} is not an onset (s) and a stage (W N1 N2 N3 R, 0 to 5, or ?) below a header that names both"
            ) from None
        if not isfinite(onset) or (found and onset <= found[-1][0]):
            raise DeviceError(f"{path}, line {line}: onset is {onset:g} s, which is not after the line before")
        found.append((onset, stage))
    if not found:
        raise DeviceError(f"{path} holds no stage")
    stages: list[str] = []
    for (onset, stage), (following, _) in zip(found, [*found[1:], (found[-1][0] + EPOCH_S, "")], strict=True):
        stages += [stage] * max(0, round((following - onset) / EPOCH_S))
    if not stages or len(stages) * EPOCH_S > LONGEST_S:
        raise DeviceError(
            f"{path} describes {len(stages) * EPOCH_S / 3600:g} h; it must be a night, at most {LONGEST_S / 3600:g} h"
        )
    return tuple(stages)


def _clock(text: str) -> tuple[int, int]:
    """Hours and minutes."""
    try:
        at = datetime.strptime(text, "%H:%M")
    except ValueError:
        raise ParameterError("evening", text, "a time of day such as 22:30") from None
    return at.hour, at.minute


def _evening(text: str, now: int, length_s: float) -> int:
    """When the night begins that is under way, or else the next one (ns)."""
    hour, minute = _clock(text)
    day = datetime.fromtimestamp(now / NS, UTC).replace(hour=hour, minute=minute, second=0, microsecond=0)
    for shift in (-1, 0, 1):
        begun = round((day + timedelta(days=shift)).timestamp()) * NS
        if now < begun + round(length_s * NS):
            return begun
    return begun
