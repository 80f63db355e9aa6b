"""`python -m bench.raspberry`: the shipped bedside graph in real time on a share of one core, as on a small computer. `--write`: into
docs/lab/bedside.md.

`kinegraph run` with configs/bedside_sleep.yaml, to which nothing is done but that its camera hands over frames of a simulated sleeper from
memory (640 x 400, 30 per second), and that an outlet notes how old each result is when it comes. All its processes stand in a control
group of Linux that has one core and, of every 100 ms, no more than `--share`: who has used it up waits for the next 100 ms. Needs root and
a control group for the processor (version 1 or 2) that can be written; without them it says so and measures nothing.

It is no Raspberry Pi: caches, memory and instructions are this machine's.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from bench.night import frames
from bench.report import HOUSE, Section, marks, publish, short, whole
from kinegraph.devices.people import bedroom
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

CONFIG = HOUSE / "configs" / "bedside_sleep.yaml"
CAMERA = """  camera:
    use: bench.raspberry.LoopedCamera
    width: 640
    height: 400
    fps: 30
    deadline_s: 600

"""
ARRIVALS = """
  arrivals:
    use: bench.raspberry.Arrivals
    from: {motion: motion, epochs: scorer}
    path: arrivals.json
"""
GOING = "going"
"""A file that is there once the first frame is."""
PERIOD_US = 100_000
GROUPS = Path("/sys/fs/cgroup")
ABOUT = "By `python -m bench.raspberry`."


@dataclass(frozen=True, slots=True)
class LoopedCamera(Source):
    """A sleeper's frames from memory, over and over, each handed over when it is due."""

    outputs: ClassVar[tuple[str, ...]] = ("depth",)

    width: int = param(640, least=16)
    height: int = param(400, least=16)
    fps: float = param(30.0, above=0.0)

    def specs(self) -> Specs:
        meta = {"device": "simulated bedroom", "invalid": 0, "simulated": True}
        return {"depth": StreamSpec((self.height, self.width), np.dtype(np.uint16), self.fps, units=("mm",), meta=meta)}

    def prepare(self) -> None:
        bedroom.prepare()

    def read(self, feed: Feed) -> None:
        seen = frames(16)[:, : self.height, : self.width].copy()
        feed.ready()
        Path(GOING).touch()
        begun, k = feed.now(), 0
        while not feed.wait(max(0.0, k / self.fps - (feed.now() - begun) / NS)):
            stamp = begun + round(k * NS / self.fps)
            feed.emit(Chunk(np.array([stamp]), seen[k % len(seen)][None], stamp), "depth")
            k += 1


@dataclass(slots=True)
class ArrivalsState:
    """None that would have to be kept."""


@dataclass(slots=True)
class ArrivalTimes:
    """How old (ms) what came was when it came: since a frame's stamp, or since an epoch's end."""

    motion: list[float] = field(default_factory=list)
    epochs: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Arrivals(Outlet[ArrivalsState, ArrivalTimes]):
    """Notes how old every change of depth, and every provisional score, is when it gets here; written at the end."""

    inputs = {"motion": Input(), "epochs": Input()}
    in_order: ClassVar[bool] = False

    path: str = param("arrivals.json")

    def open(self, specs: Specs) -> Specs:
        self.set_state(ArrivalsState(), ArrivalTimes())
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        now = time.time_ns()
        if port == "motion":
            self.runtime.motion += ((now - chunk.time) / 1e6).tolist()
        else:
            self.runtime.epochs += ((now - chunk.data["end"][~chunk.data["final"]]) / 1e6).tolist()

    def close(self) -> None:
        facts = {"motion": self.runtime.motion, "epochs": self.runtime.epochs}
        Path(self.path).write_text(json.dumps(facts), encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Group:
    """A control group: where its limits are written, and where its time (ns) is read."""

    folder: Path
    accounts: Path

    @property
    def version(self) -> int:
        return 1 if self.folder != self.accounts else 2

    def used_s(self) -> float:
        if self.version == 1:
            return int((self.accounts / "cpuacct.usage").read_text()) / NS
        return _figures(self.accounts / "cpu.stat")["usage_usec"] / 1e6

    def throttled(self) -> tuple[int, int]:
        """How many periods there were, and in how many the share was used up."""
        figures = _figures(self.folder / "cpu.stat")
        return figures["nr_periods"], figures["nr_throttled"]

    def enter(self) -> None:
        """Put this process into the group, on one core; its children come after it."""
        for folder in {self.folder, self.accounts}:
            (folder / "cgroup.procs").write_text(str(os.getpid()))
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def _figures(path: Path) -> dict[str, int]:
    return {name: int(value) for name, value in (line.split() for line in path.read_text().splitlines())}


@contextmanager
def limited(share: float) -> Iterator[Group]:
    """A group that has `share` of a core. Raises OSError if it cannot be made."""
    name, quota = f"kinegraph-bench-{os.getpid()}", str(round(share * PERIOD_US))
    if (GROUPS / "cgroup.controllers").exists():
        group = Group(GROUPS / name, GROUPS / name)
        (GROUPS / "cgroup.subtree_control").write_text("+cpu")
        group.folder.mkdir()
        (group.folder / "cpu.max").write_text(f"{quota} {PERIOD_US}")
    else:
        group = Group(GROUPS / "cpu" / name, GROUPS / "cpuacct" / name)
        for folder in (group.folder, group.accounts):
            folder.mkdir(exist_ok=True)
        (group.folder / "cpu.cfs_period_us").write_text(str(PERIOD_US))
        (group.folder / "cpu.cfs_quota_us").write_text(quota)
    try:
        yield group
    finally:
        for folder in {group.folder, group.accounts}:
            folder.rmdir()


@dataclass(frozen=True, slots=True)
class Budget:
    """What a run took.

    start_s         from the command to the first frame; start_cpu_s: processor time of all processes until then
    cpu             share of a core afterwards, all processes together
    periods, full   of 100 ms afterwards, and those in which the share was used up
    motion, epochs  ms from a stamp of the change of depth (twice a second) to its arrival, and from an epoch's end to its provisional score
    lost            chunks that were dropped, and gaps, by the session's own count; -1: unknown
    code            how kinegraph ended
    """

    share: float
    start_s: float
    start_cpu_s: float
    cpu: float
    periods: int
    full: int
    motion: list[float]
    epochs: list[float]
    lost: int
    code: int


def measured(share: float, seconds: float, folder: Path) -> Budget:
    """The graph for so many seconds from the first frame on, in a group of its own."""
    text, count = re.subn(r"  camera:\n(?:    .*\n)+\n", CAMERA, CONFIG.read_text(encoding="utf-8"))
    if count != 1:
        raise SystemExit(f"{CONFIG} has no camera of the form that this bench knows")
    (folder / "bedside.yaml").write_text(text + ARRIVALS, encoding="utf-8")
    regions = "bed.regions=[[40, 120, 320, 400]]"
    command = [
        sys.executable,
        "-c",
        "from kinegraph.stream.cli.main import main; main()",
        "run",
        "bedside.yaml",
        "-o",
        "session",
        "--view",
        "lines",
    ]
    with limited(share) as group:
        begun = time.monotonic()
        with (folder / "log.txt").open("w") as log:
            process = subprocess.Popen(
                [*command, "--set", regions], cwd=folder, preexec_fn=group.enter, stdout=log, stderr=log,
                env={**os.environ, "PYTHONPATH": str(HOUSE), "OMP_NUM_THREADS": "1"},
            )  # fmt: skip
            start_s = _going(folder, process, begun)
            start_cpu, (periods, full) = group.used_s(), group.throttled()
            time.sleep(seconds)
            cpu, (periods_after, full_after) = group.used_s() - start_cpu, group.throttled()
            process.terminate()
            code = process.wait(300)
    record = json.loads((folder / "arrivals.json").read_text(encoding="utf-8"))
    dropped = re.findall(r"dropped (\d+), gaps (\d+)", (folder / "log.txt").read_text())
    return Budget(
        share, start_s, start_cpu, cpu / seconds, periods_after - periods, full_after - full, record["motion"], record["epochs"],
        sum(map(int, dropped[-1])) if dropped else -1, code,
    )  # fmt: skip


def _going(folder: Path, process: subprocess.Popen[bytes], begun: float) -> float:
    """Wait for the first frame; how long that took (s)."""
    while process.poll() is None and time.monotonic() < begun + 1800:
        if (folder / GOING).exists():
            return time.monotonic() - begun
        time.sleep(0.05)
    raise SystemExit((folder / "log.txt").read_text()[-3000:])


HEADER = [
    "share of a core", "start", "of which processor", "processor afterwards", "100 ms that were used up",
    "stamp to change, p50", "p99", "highest", "epoch's end to score, highest", "dropped",
]  # fmt: skip


def row(of: Budget) -> list[str]:
    p50, p99 = np.percentile(of.motion, [50, 99])
    return [
        f"{of.share:g}", f"{of.start_s:.0f} s", f"{of.start_cpu_s:.1f} s", f"{100 * of.cpu:.1f} % of a core",
        f"{of.full} of {of.periods}", f"{short(float(p50))} ms", f"{short(float(p99))} ms", f"{short(max(of.motion))} ms",
        f"{short(max(of.epochs))} ms" if of.epochs else "-", str(of.lost),
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.raspberry", description=__doc__)
    parser.add_argument("--share", type=float, nargs="+", default=[0.25], help="of one core")
    parser.add_argument("--seconds", type=float, default=100.0)
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/bedside.md")
    given = parser.parse_args()
    rows = []
    for share in given.share:
        with tempfile.TemporaryDirectory() as name:
            try:
                budget = measured(share, given.seconds, Path(name))
            except OSError as error:
                raise SystemExit(f"no control group can be made here ({error}): nothing is measured") from None
            if budget.code:
                raise SystemExit((Path(name) / "log.txt").read_text()[-3000:])
        rows.append(row(budget))
        print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    sections = [Section("The shipped graph in real time on a share of one core", HEADER, rows)]
    print(whole(sections, ABOUT))
    if given.write:
        publish(sections, ABOUT, "lab/bedside.md", *marks("bench.raspberry"))


if __name__ == "__main__":
    main()
