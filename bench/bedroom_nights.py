"""`python -m bench.bedroom_nights`: sleep and wake in random tilted bedrooms, by sensor, against the same scorer on true movement; and how
many epochs are asleep in a bed that was left. A table in Markdown; `--write` puts it into docs/lab/bedside.md.

Each room is 45 minutes: from 2 to 30 min somebody lies there, breathes, and stirs alone and in two bouts; then the bed is left. What is
there afterwards goes by the room's seed: nothing, a heap of blankets, a fan that lifts the blanket, a cat that walks on the bed, somebody
who sits on the edge, or nothing with a camera that was nudged, before the sleeper left or after.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from bench.bedside import START, Run, true_states
from bench.report import Section, marks, publish, whole
from bench.rooms import CAMERAS, LEFT_OUT
from bench.scenes import GRAPH, coded
from kinegraph.devices.people.bedside import Bedside
from kinegraph.devices.people.night import EPOCH_S
from kinegraph.operators.sleep.evaluation.agreement import Confusion
from kinegraph.stream.chunk import NS, Array, Chunk
from kinegraph.stream.domain.night import SLEEP
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.source import Feed
from tests.sleep.tilted_cameras import random_room
from tests.sleep.tilted_night import HEIGHT, WIDTH
from tests.sleep.tilted_room import Frame, Map, Stay, TiltedCamera, TiltedRoom, _bump

LENGTH_S, COMES, LEAVES = 2700.0, 120.0, 1800.0
STIR_S, NUDGE_PX, STEPS = 4.0, 9, 24
AFTERWARDS = ("nothing", "heap", "fan", "cat", "sits", "nudged while in bed", "nudged when empty")
NUDGES = {"nudged while in bed": 1500.0, "nudged when empty": 2100.0}
SHOWN = ("ToF", "stereo .08 px")


class LeftRoom(TiltedRoom):
    """A tilted room whose bed is left; `afterwards`: what is there then."""

    afterwards: str
    _walks: dict[int, Map]
    _stirred: dict[float, Map]

    def frame(self, seconds: float) -> Frame:
        made = super().frame(seconds)
        if seconds >= NUDGES.get(self.afterwards, LENGTH_S):
            made = np.roll(made, NUDGE_PX, axis=1)
            made[:, :NUDGE_PX] = 0
        return made

    def _scene(self, t: float) -> Map:
        stirs = [m for m in self.stay.moves if m <= t < m + STIR_S] if COMES <= t < LEAVES else []
        if stirs:
            stir = round(max(float(np.sin(np.pi * (t - m) / STIR_S)) ** 2 for m in stirs), 3)
            if stir not in self._stirred:
                self._stirred[stir] = super()._scene(t)
            return self._stirred[stir]
        if t < LEAVES or self.afterwards not in ("cat", "sits"):
            return super()._scene(t)
        step = int(t * 2.0) % STEPS if self.afterwards == "cat" else int(12 + 12 * np.sin(0.7 * t) * np.sin(0.13 * t))
        if step not in self._walks:
            turn = 2 * np.pi * step / STEPS
            wide = self.bed[0]
            if self.afterwards == "cat":
                x, y = 0.3 * wide * np.cos(turn), 1.0 + 0.6 * np.sin(turn)
                self._walks[step] = self._surface(lambda u, v: 0.25 * _bump(u, v, x, y, 0.08, 0.15))
            else:
                x, y = wide / 2 - 0.15 + 0.012 * np.sin(turn), 1.0 + 0.01 * np.cos(turn)
                self._walks[step] = self._surface(lambda u, v: 0.85 * _bump(u, v, x, y, 0.14, 0.2), 0.9)
        return self._walks[step]


class LeftRoomSource(Bedside):
    """The room in the simulated bedroom's place."""

    __slots__ = ("room",)
    room: LeftRoom

    @staticmethod
    def of(source: Bedside, room: LeftRoom) -> LeftRoomSource:
        made = LeftRoomSource(width=source.width, height=source.height, fps=source.fps)
        object.__setattr__(made, "room", room)
        return made

    def unopened(self) -> LeftRoomSource:
        return self

    def read(self, feed: Feed) -> None:
        times = np.arange(round(LENGTH_S * self.fps)) / self.fps
        for part in np.array_split(times, max(1, len(times) // 8)):
            stamps = feed.now() + np.round(part * NS).astype(np.int64)
            frames = np.stack([self.room.frame(float(t)) for t in part])
            feed.emit(Chunk(stamps, frames, int(stamps[-1])), "depth")


@dataclass(slots=True)
class Tally:
    """Over rooms: agreement of the epochs in bed; epochs asleep after the bed was left, by what was there; epochs out though in bed."""

    rooms: int = 0
    agreed: Confusion = field(default_factory=lambda: Confusion(0, 0, 0, 0, 0))
    false_sleep: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    absent: int = 0

    def row(self) -> list[str]:
        c = self.agreed
        right = (c.both_sleep + c.both_wake) / max(1, c.epochs)
        return [
            str(self.rooms), str(c.epochs), f"{right:.3f}", f"{c.sensitivity:.3f}", f"{c.specificity:.3f}",
            f"{c.unknown / max(1, c.epochs + c.unknown):.3f}", str(self.absent),
        ]  # fmt: skip

    def left(self) -> list[str]:
        return [", ".join(map(str, self.false_sleep[name])) or "-" for name in AFTERWARDS]


def room_of(seed: int, camera: TiltedCamera) -> tuple[LeftRoom, tuple[float, ...]]:
    """A room by its seed, and when the sleeper stirs."""
    random = np.random.default_rng([seed, 6])
    single = random.uniform(200, LEAVES - 100, 5).tolist()
    bouts = [b + 11 * k for b in random.uniform(400, LEAVES - 400, 2) for k in range(int(random.integers(10, 26)))]
    moves = tuple(sorted(round(2 * m) / 2 for m in [COMES + 2, *single, *bouts, LEAVES - 5]))
    afterwards = AFTERWARDS[seed % len(AFTERWARDS)]
    thing = {afterwards: (LEAVES, LENGTH_S)} if afterwards in ("heap", "fan") else {}
    stay = Stay(
        COMES,
        LEAVES,
        float(random.uniform(8, 28)),
        float(random.uniform(2, 6)),
        moves=moves,
        **thing,  # type: ignore[arg-type]
    )
    room, *_ = random_room(seed, WIDTH, HEIGHT, camera, stay)
    room.__class__ = LeftRoom
    assert isinstance(room, LeftRoom)
    room.afterwards, room._walks, room._stirred = afterwards, {}, {}
    return room, moves


def measured(seed: int, camera: TiltedCamera, tally: Tally) -> None:
    """One room through the graph."""
    room, moves = room_of(seed, camera)
    graph = load_text(GRAPH)
    graph.nodes["camera"].part = LeftRoomSource.of(graph.nodes["camera"].part, room)  # type: ignore[arg-type]
    run = Run(graph, ("scorer", "activity.epochs")).run()
    truth = truth_of(moves)
    states = on_epochs(run["scorer"][run["scorer"]["final"]], "state", len(truth))
    beds = on_epochs(run["activity.epochs"], "bed", len(truth))
    in_bed = truth["in_bed_s"] == EPOCH_S
    left = (truth["in_bed_s"] == 0) & (truth["onset"] >= START + LEAVES * NS)
    tally.rooms += 1
    tally.agreed += Confusion.of(coded(states)[in_bed], coded(true_states(truth)[: len(truth)])[in_bed])
    tally.false_sleep[room.afterwards].append(int((coded(states)[left] == SLEEP).sum()))
    tally.absent += int((beds[in_bed] == "out").sum())


def truth_of(moves: tuple[float, ...]) -> Array:
    """The epochs: onset in ns, and the seconds in each in bed, and in movement."""
    n = int(LENGTH_S // EPOCH_S)
    made = np.zeros(n, [("onset", "<i8"), ("in_bed_s", "<f8"), ("moved_s", "<f8")])
    begin = np.arange(n) * EPOCH_S
    made["onset"] = START + begin.astype(np.int64) * NS
    made["in_bed_s"] = np.clip(np.minimum(LEAVES, begin + EPOCH_S) - np.maximum(COMES, begin), 0, None)
    second = np.arange(0, LENGTH_S, 0.1)
    moving = np.logical_or.reduce([(second >= m) & (second < m + STIR_S) for m in moves])
    made["moved_s"] = moving.reshape(n, -1).sum(axis=1) / 10
    return made


def on_epochs(events: Array, name: str, count: int) -> Array:
    made = np.full(count, "unknown", "<U8")
    for event in events:
        place = int((event["onset"] - START) // (EPOCH_S * NS))
        if 0 <= place < count:
            made[place] = str(event[name])
    return made


HEADER = [
    "sensor", "rooms", "count", "epochs", "agreement", "sensitivity", "specificity", "unknown", "out, somebody there (epochs)",
]  # fmt: skip
ABOUT = "By `python -m bench.bedroom_nights`. Chosen-on rooms have seeds below 1000."
TITLE = "Epochs in bed against the same scorer on true movement, in random tilted rooms"
LEFT = "Epochs asleep in the 15 minutes after the bed was left, room by room, by what was there then"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.bedroom_nights", description=__doc__)
    parser.add_argument("--rooms", type=int, default=7, help="of each kind")
    parser.add_argument("--only", nargs="+", choices=list(CAMERAS), default=list(SHOWN), metavar="SENSOR")
    parser.add_argument("--chosen", action="store_true", help="leave the left-out rooms alone")
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/bedside.md")
    given = parser.parse_args()
    rows: list[list[str]] = []
    left: list[list[str]] = []
    for name in given.only:
        for kind, first in (("chosen on", 420), ("left out", LEFT_OUT + 320))[: 1 if given.chosen else 2]:
            tally = Tally()
            for seed in range(first, first + given.rooms):
                measured(seed, CAMERAS[name], tally)
                print(
                    name, seed, AFTERWARDS[seed % 7], tally.agreed, dict(tally.false_sleep), file=sys.stderr, flush=True
                )
            rows.append([name, kind, *tally.row()])
            left.append([name, kind, *tally.left()])
    sections = [Section(TITLE, HEADER, rows), Section(LEFT, ["sensor", "rooms", *AFTERWARDS], left)]
    print(whole(sections, ABOUT))
    if given.write:
        publish(sections, ABOUT, "lab/bedside.md", *marks("bench.bedroom_nights"))


if __name__ == "__main__":
    main()
