"""Soak: all uses at the same time, for minutes, under faults drawn from a seed; every sample accounted for.

    python -m tests.soak --minutes 20 --seed 1

Each use runs as its shipped graph, as a process, in real time, beside a serial device that counts its own samples. Cables are pulled,
processes are stopped and killed and started again, disks fill up, brokers vanish or stop reading, browsers
look and stop reading, the wall clock is set. Afterwards the
recording of every stream is held against what was offered, the table of what was written against the recording, and a replay against the
live results. Then ten hours of each use run as fast as they can (`--minutes 0`: these alone; `--hours 0`: without): memory, open files and
threads. Ends with 1 if anything does not hold.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.soak.faults import KINDS, Fault, drawn
from tests.soak.growth import Growth, grown
from tests.soak.happening import soak
from tests.soak.judge import Judged, judge
from tests.soak.uses import USES, Use
from tests.soak.watched import Watched


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.soak", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=20.0, help="of real time under faults")
    parser.add_argument("--seed", type=int, default=1, help="another seed, other faults")
    parser.add_argument("--uses", nargs="*", default=[use.name for use in USES], help="which of the uses")
    parser.add_argument("--only", nargs="*", choices=KINDS, default=KINDS, help="which kinds of faults")
    parser.add_argument("--pace", type=float, default=1.0, help="how many times as often as usual they happen")
    parser.add_argument("--hours", type=float, default=10.0, help="so many of each use, as fast as they go; 0: skip")
    parser.add_argument("--no-hours", action="store_true", help="the same as --hours 0")
    parser.add_argument("--keep", type=Path, help="keep everything in this folder")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kinegraph-soak-") as made:
        folder = given.keep or Path(made)
        uses = [use for use in USES if use.name in given.uses]
        names = tuple(use.name for use in uses)
        faults = drawn(given.seed, given.minutes * 60, names, only=tuple(given.only), pace=given.pace)
        print(f"{len(faults)} faults within {given.minutes:g} min, seed {given.seed}", flush=True)
        good = whole(folder, uses, faults, given.minutes * 60, hours=0 if given.no_hours else given.hours)
    sys.exit(0 if good else 1)


def whole(folder: Path, uses: list[Use], faults: list[Fault], seconds: float, *, hours: float) -> bool:
    """Run the soak and print what came of it; whether everything holds."""
    sessions: list[Watched] = []
    try:
        for use in uses if seconds else []:
            sessions.append(Watched(use, folder / use.name))
            sessions[-1].start()
        done = soak(sessions, faults, seconds)
    finally:
        for watched in sessions:
            watched.close()
    print("happened: " + ", ".join(f"{kind} {done[kind]}" for kind in KINDS), flush=True)
    judged = [judge(watched) for watched in sessions]
    print(Judged.table(judged), flush=True)
    growths = [grown(use, folder / f"{use.name}-hours", hours) for use in uses] if hours else []
    if growths:
        print(Growth.table(growths), flush=True)
    complaints = [line for one in (*judged, *growths) for line in one.complaints]
    print("\n".join(complaints) or "everything holds")
    return not complaints


if __name__ == "__main__":
    main()
