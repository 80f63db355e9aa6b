"""`python -m bench.breaths`: rate and pauses of uneven breath in random tilted bedrooms, by sensor and lift; a table in Markdown.
`--write` puts it into docs/lab/bedside.md.

Breath is drawn breath by breath: 10 to 26 per minute, their lengths vary by 8 % and their lifts by 20 % (standard deviations), one of 60
is a sigh of twice the lift, and the lift waxes and wanes by a quarter over a minute. Each room is 20 minutes of somebody who lies still;
pauses of 12, 15, 20 and 30 s follow each other, one a minute, in every other five minutes; in the others all that is reported is false.
Truth of a rate: the breaths of its epoch, with parts of breaths.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from bench.report import Section, marks, publish, whole
from bench.rooms import CAMERAS, LEFT_OUT
from kinegraph.operators.bed.breathing import Breathing
from kinegraph.stream.chunk import NS, Array
from tests.sleep.depth_frames import play
from tests.sleep.tilted_cameras import random_room
from tests.sleep.tilted_night import HEIGHT, START, WIDTH, inputs
from tests.sleep.tilted_room import Stay, TiltedCamera, TiltedRoom

FPS, SECONDS, TICK_S = 4.0, 1200.0, 0.05
LENGTHS = (12.0, 15.0, 20.0, 30.0)
LATE_S = 12.0
"""A pause is found if one is reported in an epoch that overlaps it, or in the one of so long after its end."""
SHOWN = ("ToF", "stereo .08 px", "ToF, twice the noise")


@dataclass(frozen=True, slots=True)
class Breath:
    """lift (n,) mm and breaths (n,) so far, every `TICK_S`; pauses (k, 2): from, to."""

    lift: Array
    breaths: Array
    pauses: Array


def drawn(seed: int, lift_mm: float, uneven: float = 0.08) -> Breath:
    """20 minutes of breath."""
    random = np.random.default_rng([seed, 8])
    per_s = float(random.uniform(10, 26)) / 60
    starts = [150.0 + 60 * k + float(random.uniform(0, 15)) for k in range(17)]
    wanted = [s for s in starts if s // 300 % 2 == 0]
    pauses = [(s, s + LENGTHS[(k + seed) % len(LENGTHS)]) for k, s in enumerate(wanted)]
    time = np.arange(0, SECONDS, TICK_S)
    lift, breaths = np.zeros(len(time)), np.zeros(len(time))
    at, count, held = 0.0, 0.0, []
    while at < SECONDS:
        if pauses and at >= pauses[0][0]:
            pauses.pop(0)
            held.append((at, at + LENGTHS[(len(held) + seed) % len(LENGTHS)]))
            breaths[(time >= at)] = count
            at = held[-1][1]
            continue
        length = float(np.exp(random.normal(0, uneven))) / per_s
        size = lift_mm * (1 + 0.25 * np.sin(2 * np.pi * at / 60)) * max(0.3, 1 + 0.2 * float(random.normal()))
        size *= 2.0 if random.random() < 1 / 60 else 1.0
        here = (time >= at) & (time < at + length)
        phase = (time[here] - at) / length
        rise = np.sin(np.pi * phase / 0.8) ** 2
        fall = np.cos(np.pi * np.minimum(phase - 0.4, 0.45) / 0.9) ** 2
        lift[here] = size * np.where(phase < 0.4, rise, fall)
        breaths[here] = count + phase
        at, count = at + length, count + 1
    return Breath(lift, breaths, np.array(held))


class BreathingRoom(TiltedRoom):
    """A tilted room with this breath in it."""

    breath: Breath

    def lift(self, seconds: float) -> float:
        return float(self.breath.lift[min(int(seconds / TICK_S), len(self.breath.lift) - 1)])


@dataclass(slots=True)
class Tally:
    """Over rooms: pauses by length (found, all), false ones, hours; epochs, those with a rate, their errors, those in the interval."""

    rooms: int = 0
    pauses: dict[float, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    false: int = 0
    hours: float = 0.0
    still: int = 0
    known: int = 0
    covered: int = 0
    errors: list[float] = field(default_factory=list)

    def row(self) -> list[str]:
        middle, most = np.percentile(self.errors, (50, 95)) if self.errors else (np.nan, np.nan)
        return [
            str(self.rooms), f"{self.known / max(1, self.still):.2f} of {self.still}", f"{middle:.2f} / {most:.2f}",
            f"{self.covered / max(1, self.known):.2f}",
            *(f"{self.pauses[s][0]} of {self.pauses[s][1]}" for s in LENGTHS), f"{self.false / max(self.hours, 1e-9):.1f}",
        ]  # fmt: skip


def breathed(seed: int, camera: TiltedCamera, lift_mm: float, uneven: float = 0.08) -> tuple[Breath, Array]:
    """What happened, and what the operator reports of it."""
    breath = drawn(seed, lift_mm, uneven)
    room, *_ = random_room(seed, WIDTH, HEIGHT, camera, Stay(0, 1e9))
    room.__class__ = BreathingRoom
    assert isinstance(room, BreathingRoom)
    room.breath = breath
    return breath, play(Breathing(), **inputs(room, SECONDS, FPS))["out"]


def measured(seed: int, camera: TiltedCamera, lift_mm: float, tally: Tally) -> None:
    breath, made = breathed(seed, camera, lift_mm)
    begin = (made["onset"] - START) / NS
    end = begin + 30
    paused = np.array(
        [((breath.pauses[:, 0] < b) & (breath.pauses[:, 1] > a)).any() for a, b in zip(begin, end, strict=True)]
    )
    still = (begin >= 60) & (end <= SECONDS) & ~paused
    per_min = (
        2
        * np.diff(np.interp(np.stack([begin, end]), np.arange(len(breath.breaths)) * TICK_S, breath.breaths), axis=0)[0]
    )
    known = np.isfinite(made["rate"])
    errors = np.abs(made["rate"] - per_min)
    tally.rooms += 1
    tally.still += int(still.sum())
    tally.known += int((still & known).sum())
    tally.errors += errors[still & known].tolist()
    tally.covered += int((errors <= made["error"])[still & known].sum())
    left = np.nan_to_num(made["pauses"]).copy()
    for a, b in breath.pauses:
        if b + LATE_S >= SECONDS:
            continue
        near = np.flatnonzero((left > 0) & (begin <= b + LATE_S) & (end > a))
        tally.pauses[float(round(b - a))][1] += 1
        if len(near):
            left[near[0]] -= 1
            tally.pauses[float(round(b - a))][0] += 1
    tally.false += int(left[: len(left)].sum())
    tally.hours += SECONDS / 3600


HEADER = [
    "sensor", "lift (mm)", "seeds", "rooms", "still epochs with a rate", "error of the rate, median / 95 % (1/min)", "within its interval",
    *(f"pauses of {s:.0f} s" for s in LENGTHS), "false per h",
]  # fmt: skip
ABOUT = "By `python -m bench.breaths`. Chosen-on rooms have seeds below 1000."
TITLE = "Uneven breath in random tilted rooms: rates, and pauses found"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.breaths", description=__doc__)
    parser.add_argument("--rooms", type=int, default=4, help="of each kind")
    parser.add_argument("--lifts", type=float, nargs="+", default=[2.0, 4.0, 6.0], metavar="MM")
    parser.add_argument("--only", nargs="+", choices=list(CAMERAS), default=list(SHOWN), metavar="SENSOR")
    parser.add_argument("--chosen", action="store_true", help="leave the left-out rooms alone")
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/bedside.md")
    given = parser.parse_args()
    rows: list[list[str]] = []
    for name in given.only:
        for lift_mm in given.lifts:
            for kind, first in (("chosen on", 500), ("left out", LEFT_OUT + 500))[: 1 if given.chosen else 2]:
                tally = Tally()
                for seed in range(first, first + given.rooms):
                    measured(seed, CAMERAS[name], lift_mm, tally)
                rows.append([name, f"{lift_mm:g}", kind, *tally.row()])
                print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    sections = [Section(TITLE, HEADER, rows)]
    print(whole(sections, ABOUT))
    if given.write:
        publish(sections, ABOUT, "lab/bedside.md", *marks("bench.breaths"))


if __name__ == "__main__":
    main()
