"""Nights on which much goes wrong, made up from a seed, on the renderer of tests/support/rendered_room.py; run in a process that is killed.

`python hard_night.py CONFIG FOLDER [--resume]` runs one; the wall clock is off by the seconds that the file `clock` beside CONFIG holds.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np

from kinegraph.devices.people.bedside import Bedside
from kinegraph.devices.reports.night import archive
from kinegraph.stream.chunk import NS, Chunk, empty
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed
from tests.support.rendered_room import Renderer, Scene

CLOCKS = (
    ("Europe/Berlin", "2026-10-25T02:10"),
    ("Europe/Berlin", "2026-03-29T01:00"),
    ("America/New_York", "2026-11-01T01:20"),
    ("Australia/Lord_Howe", "2026-04-05T01:10"),
    ("UTC", "2026-06-01T22:00"),
)
"""Where the night is, and when it begins: the clocks change in the middle of it, but for the last."""
FPS = 1.0
GRAPH = """
checkpoint_s: 0.1
record: [presence, activity, activity.epochs]
recording: {folder: recordings, rolling: true, rotate_mb: 0.02, flush_s: 0.2}
nodes:
  camera: {use: tests.sleep.hard_night.HardRoom, width: 192, height: 144, fps: FPS, seed: SEED, begun_ns: BEGUN}
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera.depth}
  view: {use: operators.bed.frames.view.View, from: simplify.blocks}
  bed: {use: operators.bed.bed.BedRegion, from: {view: view, in: simplify.blocks}}
  presence: {use: operators.bed.presence.Presence, from: {view: view, regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.bed.motion.Motion, from: {regions: bed, frames: simplify, scene: simplify.scene}}
  activity: {use: operators.bed.activity.Activity, from: {view: view, bed: presence, far: motion.far, motion: motion}}
  breathing: {use: operators.bed.breathing.Breathing, from: {regions: bed, bed: presence, blocks: simplify.blocks}}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: {in: activity, seen: activity.epochs}}
  nights: {use: operators.sleep.nights.Nights, from: {bed: presence}, shortest_h: 0.3}
  statistics: {use: operators.sleep.statistics.SleepStatistics, from: {epochs: scorer, periods: nights}}
  log:
    use: devices.reports.night.NightLog
    from: {epochs: scorer, nights: statistics, bed: presence, seen: activity.epochs, breathing: breathing, view: view}
    path: nights
    timezone: ZONE
"""


@dataclass(frozen=True, slots=True)
class HardNight:
    """What happens: the scene, where and when it is (ns UTC), and the power cuts: (after how many logged epochs, for how many s)."""

    scene: Scene
    zone: str
    begun: int
    cuts: tuple[tuple[int, float], ...]
    set_back: bool
    """Whether the wall clock is an hour slow after the first cut."""

    @staticmethod
    def of(seed: int) -> HardNight:
        rng = np.random.default_rng([seed, 40])
        up = 240.0 + 60 * float(rng.integers(75, 100))

        def some(most: int, low: float, high: float) -> tuple[tuple[float, float], ...]:
            """At most so many stretches of this many minutes while somebody is in bed."""
            found = []
            for at in np.sort(rng.uniform(1500, up - 1500, rng.integers(0, most + 1))).tolist():
                if not found or at > found[-1][1] + 300:
                    found.append((at, at + 60 * float(rng.uniform(low, high))))
            return tuple(found)

        lamp, partner, dark, standing = some(2, 3, 12), some(1, 5, 12), some(1, 4, 12), some(2, 1, 5)
        nudges = tuple((at, float(rng.choice([-1, 1]) * rng.uniform(0.05, 0.1)), 0.0) for at, _ in some(1, 1, 1))
        bouts = [np.arange(at, at + 60 * rng.uniform(2, 6), 12.0) for at in rng.uniform(900, up - 400, 3)]
        moves = np.sort(np.concatenate([rng.uniform(200, up, 12), *bouts]))
        heaped = rng.random() < 0.3
        # after a nudge, or of a heap, it takes 45 min without any movement to know that the bed is empty
        length = up + (3600.0 if nudges or heaped else 480.0)
        scene = Scene(
            length, ((240.0, up),), partner=partner, heap=((up, length),) if heaped else (), standing=standing,
            moves=tuple(moves.tolist()), partner_moves=tuple(float(t) for a, b in partner for t in np.arange(a + 10, b, 40)),
            lamp=lamp, nudges=nudges, dark=dark, seed=seed,
        )  # fmt: skip
        zone, evening = CLOCKS[seed % len(CLOCKS)]
        begun = round(datetime.fromisoformat(evening).replace(tzinfo=ZoneInfo(zone)).timestamp()) * NS
        cuts = sorted(rng.integers(5, up // 30 - 40, rng.integers(1, 4)).tolist())
        lost = rng.choice([2.0, 45.0, 200.0, 700.0], len(cuts))
        return HardNight(scene, zone, begun, tuple(zip(cuts, lost.tolist(), strict=True)), bool(rng.random() < 0.5))


@dataclass(frozen=True, slots=True)
class HardRoom(Bedside):
    """The night's frames from the session's now on, as fast as they are taken."""

    begun_ns: int = param(0, least=0)

    def read(self, feed: Feed) -> None:
        night = HardNight.of(self.seed)
        renderer = Renderer(night.scene, self.width, self.height)
        truth = Bedside.specs(self)["truth"]
        first = max(0, -(-(feed.now() - self.begun_ns) // round(NS / self.fps)))
        feed.ready()
        for k in range(first, round(night.scene.length * self.fps), 8):
            times = np.arange(k, min(k + 8, round(night.scene.length * self.fps))) / self.fps
            stamps = self.begun_ns + np.round(times * NS).astype(np.int64)
            if feed.stopped:
                return
            feed.emit(Chunk(stamps, np.stack([renderer.frame(float(t)) for t in times]), int(stamps[-1])), "depth")
            feed.emit(empty(truth, int(stamps[-1])), "truth")


@dataclass(frozen=True, slots=True)
class Lived:
    """A night that is over: its folder, and when nothing ran (ns)."""

    night: HardNight
    folder: Path
    off: tuple[tuple[int, int], ...]


def live(seed: int, folder: Path) -> Lived:
    """A night from evening to morning with its power cuts: the process is killed, and goes on later."""
    night = HardNight.of(seed)
    config = folder / "night.yaml"
    text = GRAPH.replace("SEED", str(seed)).replace("BEGUN", str(night.begun)).replace("ZONE", night.zone)
    config.write_text(text.replace("FPS", str(FPS)).replace("path: nights", f"path: {folder / 'nights'}"))
    off: list[tuple[int, int]] = []
    process = _started(config, night.begun)
    for k, (after, seconds) in enumerate(night.cuts):
        rows = _logged(folder, process, after)
        if process.poll() is not None:
            break
        process.kill()
        process.wait(60)
        rows = _logged(folder, process, 0)
        last = int(rows[-1]) if len(rows) else night.begun
        back = last + 90 * NS + round(seconds * NS)
        if night.set_back and k == 0:
            back -= 3600 * NS  # who does not know it goes on where it was
        off.append((last, max(last, back)))
        process = _started(config, back, "--resume")
    code = process.wait(900)
    assert code == 0, (folder / "log.txt").read_text()[-3000:]
    ((found, _),) = archive.nights(folder / "nights")
    return Lived(night, found, tuple(off))


def _logged(folder: Path, process: subprocess.Popen[bytes], least: int) -> np.ndarray:
    """The ends (ns) of the logged epochs, once there are so many, or the process is over."""
    while True:
        over = process.poll() is not None
        for path in (folder / "nights").glob(f"*/{archive.EPOCHS}"):
            rows = archive.read_epochs(path.parent)
            if len(rows) >= least:
                return np.asarray(rows.end)
        if over or not least:
            return np.empty(0, np.int64)
        time.sleep(0.02)


def _started(config: Path, now: int, *options: str) -> subprocess.Popen[bytes]:
    """The night's process, with a wall clock of `now` (ns)."""
    config.with_name("clock").write_text(str(now - time.time_ns()))
    command = [sys.executable, __file__, str(config), str(config.with_name("session")), *options]
    with config.with_name("log.txt").open("ab") as log:
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)


def main() -> None:
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.graph.reading.load import load

    config, folder, *options = sys.argv[1:]
    wall, off = time.time_ns, json.loads(Path(config).with_name("clock").read_text())
    time.time_ns = lambda: wall() + off
    time.time = lambda: time.time_ns() / NS
    logs.set_up()
    session = Session(load(Path(config)), Path(folder), resume="--resume" in options)
    signal.signal(signal.SIGTERM, lambda *_: session.stop())
    outcome = session.run()
    if outcome.error:
        raise outcome.error
    sys.exit(outcome.exit_code)


if __name__ == "__main__":
    main()
