"""`python -m bench.rooms`: bed, breath and presence in random tilted bedrooms, by sensor and noise; a table in Markdown.
`--write` puts it into docs/lab/bedside.md.

Rooms, cameras (1.2 to 2.8 m high, tilted by 0 to 60 degrees, at the foot, a side or the head) and breath (6 to 45 per minute, 2 to 6 mm)
are drawn by seed. Rules were chosen on seeds below 1000; the others are shown apart. In each room the bed is empty for a minute and a
half, then somebody lies there and breathes, pauses for 20 s twice, and leaves; a fan lifts the blanket, or a heap is left.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field

import numpy as np

from bench.report import Section, marks, publish, whole
from kinegraph.operators.bed.bed_plateau import BedLimits, bed_in
from kinegraph.operators.bed.breathing import Breathing
from kinegraph.operators.bed.frames.regions import REGION, region_spec
from kinegraph.operators.bed.presence import Presence
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import META, blocks_spec, play
from tests.sleep.tilted_cameras import on_mattress, random_room
from tests.sleep.tilted_night import HEIGHT, START, WIDTH, blocks_of
from tests.sleep.tilted_room import Stay, TiltedCamera, TiltedRoom

CAMERAS = {
    "ToF": TiltedCamera(),
    "ToF, correlated .6": TiltedCamera(correlated=0.6),
    "ToF, twice the noise": TiltedCamera(noise=2.0),
    "stereo .08 px": TiltedCamera(sensor="stereo"),
    "stereo .04 px": TiltedCamera(sensor="stereo", noise=0.5),
}
FPS, SECONDS, COMES, LEAVES = 4.0, 600.0, 90.0, 450.0
PAUSES = ((225.0, 245.0), (325.0, 345.0))
LIMITS = BedLimits(200.0, 1200.0, 0.08)
LEFT_OUT = 1000


@dataclass(slots=True)
class Tally:
    """Counts over rooms. absent: epochs out of bed with somebody there; present: in bed with an empty bed."""

    rooms: int = 0
    found: int = 0
    still: int = 0
    known: int = 0
    errors: list[float] = field(default_factory=list)
    covered: int = 0
    empty: int = 0
    empty_rates: int = 0
    absent: int = 0
    present: int = 0
    pauses: int = 0
    false_pauses: int = 0

    def row(self) -> list[str]:
        middle, most = np.percentile(self.errors, (50, 95)) if self.errors else (np.nan, np.nan)
        hours = self.rooms * (LEAVES - COMES) / 3600
        return [
            f"{self.found} of {self.rooms}", f"{self.known / max(1, self.still):.2f} of {self.still}", f"{middle:.2f} / {most:.2f}",
            f"{self.covered / max(1, self.known):.2f}", f"{self.empty_rates} of {self.empty}", str(self.absent), str(self.present),
            f"{self.pauses / (len(PAUSES) * self.rooms):.2f}", f"{self.false_pauses / hours:.1f}",
        ]  # fmt: skip


def measured(seed: int, camera: TiltedCamera, tally: Tally) -> None:
    """One room."""
    random = np.random.default_rng([seed, 5])
    per_min, lift = float(random.uniform(6, 45)), float(random.uniform(2, 6))
    after = (LEAVES, SECONDS)
    stay = Stay(
        COMES, LEAVES, per_min, lift, moves=(COMES + 2, 150.0), pauses=PAUSES, **{("fan", "heap")[seed % 2]: after}
    )
    room, *_ = random_room(seed, WIDTH, HEIGHT, camera, stay)
    depth = blocks_of(room, SECONDS, FPS)
    found = _bed(room, depth, tally)
    time = grid(FPS, len(depth), START)
    given = {
        "regions": (region_spec(("a",), META), found["onset"].copy(), found),
        "blocks": (blocks_spec(*depth.shape[1:], FPS), time, depth),
    }
    presence = play(Presence(), **given)["out"]
    bed = (
        StreamSpec((), presence.dtype, meta=META),
        np.maximum.accumulate(presence["onset"] + 5 * NS),
        presence,
    )  # it holds for 5 s
    breaths = play(Breathing(), regions=given["regions"], bed=bed, blocks=given["blocks"])["out"]
    begin = (breaths["onset"] - START) / NS
    end = begin + 30
    paused = np.logical_or.reduce([(begin < b) & (end > a) for a, b in PAUSES])
    still = (begin >= 180) & (end <= LEAVES) & ~paused
    bed_empty = (end <= COMES) | (begin >= LEAVES + 15)
    known = np.isfinite(breaths["rate"])
    errors = np.abs(breaths["rate"] - per_min)
    tally.still += int(still.sum())
    tally.known += int((still & known).sum())
    tally.errors += errors[still & known].tolist()
    tally.covered += int((errors <= breaths["error"])[still & known].sum())
    tally.empty += int(bed_empty.sum())
    tally.empty_rates += int((bed_empty & known).sum())
    counted = int(np.nansum(breaths["pauses"][end <= LEAVES + 30]))
    tally.pauses += min(counted, len(PAUSES))
    tally.false_pauses += max(0, counted - len(PAUSES))
    states = _states(presence, np.concatenate([begin, begin + 15]))
    there = np.tile((begin >= COMES + 60) & (end <= LEAVES), 2)
    gone = np.tile((end <= COMES) | (begin >= LEAVES + 90), 2)
    tally.absent += int((there & (states == "out")).sum() // 2)
    tally.present += int((gone & (states == "in")).sum() // 2)
    tally.rooms += 1


def _bed(room: TiltedRoom, depth: Array, tally: Tally) -> Array:
    """The region as it is found in the first half minute; as a person would set it where that is wrong, which is counted."""
    found = bed_in(_mean(depth[: int(30 * FPS)]), LIMITS)
    rectangle = room.rectangle()
    if found is not None and _holds(room, found):
        tally.found += 1
        row, column, rows, columns = (8 * side for side in found)
        rectangle = row, column, rows, columns
    return np.array([(START, "a", *rectangle, True)], REGION)


def _mean(depth: Array) -> Array:
    """Of frames (n, rows, columns), block by block; NaN where no frame has a value."""
    known = np.isfinite(depth).sum(axis=0)
    return np.where(known, np.nansum(depth, axis=0) / np.maximum(known, 1), np.nan)


def _holds(room: TiltedRoom, found: tuple[int, int, int, int]) -> bool:
    """Whether a rectangle in blocks holds three quarters of the mattress, and is mattress for more than half."""
    row, column, rows, columns = (8 * side for side in found)
    bed = on_mattress(room)
    inside = bed[row : row + rows, column : column + columns]
    return bool(inside.sum() > 0.75 * bed.sum() and inside.mean() > 0.5)


def beds_found(first: int, count: int, camera: TiltedCamera, stay: Stay) -> int:
    """In how many rooms one second shows the bed."""
    right = 0
    for seed in range(first, first + count):
        room, *_ = random_room(seed, WIDTH, HEIGHT, camera, stay)
        found = bed_in(_mean(blocks_of(room, 1.0, FPS)), LIMITS)
        right += found is not None and _holds(room, found)
    return right


def _states(events: Array, at: Array) -> Array:
    place = np.searchsorted((events["onset"] - START) / NS, at, side="right") - 1
    return np.where(place >= 0, events["state"][np.maximum(place, 0)], "unknown")


HEADER = [
    "sensor", "rooms", "bed found", "still epochs with a rate", "error of the rate, median / 95 % (1/min)", "within its interval",
    "rate in an empty bed", "out, somebody there (epochs)", "in, bed empty (epochs)", "pauses of 20 s found", "false pauses per h",
]  # fmt: skip
BEDS = ["sensor", "rooms", "bed found, nobody there", "bed found, somebody in it from the start"]
ABOUT = "By `python -m bench.rooms`. Chosen-on rooms have seeds below 1000; rules were not changed after the left-out ones were seen."
TITLE = "Bed, breath and presence in random tilted rooms: breath of 2 to 6 mm, 6 to 45 per minute"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.rooms", description=__doc__)
    parser.add_argument("--rooms", type=int, default=8, help="of each kind")
    parser.add_argument("--beds", type=int, default=80, help="rooms of each kind in which only the bed is looked for")
    parser.add_argument("--only", nargs="+", choices=list(CAMERAS), default=list(CAMERAS), metavar="SENSOR")
    parser.add_argument("--chosen", action="store_true", help="leave the left-out rooms alone")
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/bedside.md")
    given = parser.parse_args()
    rows: list[list[str]] = []
    beds: list[list[str]] = []
    for name in given.only:
        for kind, first in (("chosen on", 400), ("left out", LEFT_OUT))[: 1 if given.chosen else 2]:
            tally = Tally()
            for seed in range(first, first + given.rooms):
                measured(seed, CAMERAS[name], tally)
            rows.append([name, kind, *tally.row()])
            print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
            counts = (beds_found(first, given.beds, CAMERAS[name], stay) for stay in (Stay(), Stay(0, 1e9)))
            beds.append([name, kind, *(f"{count} of {given.beds}" for count in counts)])
            print(" | ".join(beds[-1]), file=sys.stderr, flush=True)
    sections = [Section(TITLE, HEADER, rows), Section("Whether the bed is found", BEDS, beds)]
    print(whole(sections, ABOUT))
    if given.write:
        publish(sections, ABOUT, "lab/bedside.md", *marks("bench.rooms"))


if __name__ == "__main__":
    main()
