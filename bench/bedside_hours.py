"""`python -m bench.bedside_hours`: what the shipped bedside graph costs over ten hours of frames of 640 x 400: processor time a frame, and
memory hour by hour. `--write`: into docs/lab/bedside.md.

`kinegraph run` with configs/bedside_sleep.yaml in a process of its own, one frame a chunk, as fast as the graph takes them: log, recording,
MQTT to a Mosquitto broker, the night's report. Its camera hands over frames of a tilted room from memory; its two switches, which go by
the wall clock, are left out. Somebody lies there from the tenth minute to the end of the eighth hour, breathes 15 times a minute, stirs
every ten minutes, and is away for five after the fourth hour. Processor time is that of all threads of the process, memory what it and
its children have resident. First half an hour at 30 frames per second, for the processor; then ten hours at `--fps`.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from ruamel.yaml import YAML

from bench.night import resident_mib
from bench.report import HOUSE, Goal, Section, marks, publish, short, whole
from kinegraph.devices.reports.night import archive
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.graph.reading.load import read_expanded
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source
from tests.sleep.tilted_cameras import PLAIN
from tests.sleep.tilted_room import Stay, TiltedRoom
from tests.support.mosquitto import broker

CONFIG = HOUSE / "configs" / "bedside_sleep.yaml"
WIDTH, HEIGHT, MAX_FPS = 640, 400, 30
PER_MIN = 15.0
ENTERS, AWAY, BACK, LEAVES = 600.0, 14_400.0, 14_700.0, 28_800.0
STIRS_EVERY_S, STIRS_S = 600.0, 4.0
SLICE_S = 30.0
FACTS = "hours.json"
ABOUT = "By `python -m bench.bedside_hours`."


def pictures(fps: float) -> dict[str, Array]:
    """What is seen, frame after frame, over and over: the empty bed, a breath, a sleeper who stirs."""
    breath, stir = round(60 / PER_MIN * fps), round(STIRS_S * fps)
    stay = Stay(0.0, 1e9, PER_MIN, moves=(1000.0,))
    full, bare = (TiltedRoom(WIDTH, HEIGHT, PLAIN, s) for s in (stay, Stay()))
    return {
        "empty": np.stack([bare.frame(k / fps) for k in range(max(8, round(fps)))]),
        "sleeper": np.stack([full.frame(k / fps) for k in range(breath)]),
        "stirs": np.stack([full.frame(1000.0 + k / fps) for k in range(stir)]),
    }


def scene(seconds: float) -> str:
    """Which of the pictures is seen then."""
    if seconds < ENTERS or AWAY <= seconds < BACK or seconds >= LEAVES:
        return "empty"
    return "stirs" if (seconds - ENTERS) % STIRS_EVERY_S < STIRS_S else "sleeper"


@dataclass(frozen=True, slots=True)
class Hours(Source):
    """The frames of so many hours, as fast as they are taken; after each hour it notes the process's time and memory in hours.json."""

    outputs: ClassVar[tuple[str, ...]] = ("depth",)

    hours: float = param(10.0, above=0.0)
    fps: float = param(30.0, above=0.0, most=float(MAX_FPS))

    @property
    def live(self) -> bool:
        return False

    def specs(self) -> Specs:
        meta = {"device": "simulated bedroom", "invalid": 0, "simulated": True}
        return {"depth": StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), self.fps, units=("mm",), meta=meta)}

    def read(self, feed: Feed) -> None:
        seen = pictures(self.fps)
        gc.collect()
        feed.ready()
        begun, count = -(-feed.now() // (30 * NS)) * 30 * NS, round(self.hours * 3600 * self.fps)
        notes: list[dict[str, float]] = []
        slices: list[float] = []
        size, spent = round(SLICE_S * self.fps), time.process_time()
        for k in range(count + 1):
            if k and k % size == 0:
                before, spent = spent, time.process_time()
                slices += [1000 * (spent - before) / size] if k / self.fps > ENTERS + SLICE_S else []
            if k % min(round(3600 * self.fps), count) == 0:
                note = {"frames": k, "cpu_s": time.process_time(), "mib": resident_mib()}
                notes.append({"hours": k / 3600 / self.fps, **note, "children_mib": _children_mib()})
                facts = json.dumps({"notes": notes, "slices": slices})
                Path(FACTS).write_text(facts, encoding="utf-8")
            if feed.stopped:
                return
            frames = seen[scene(k / self.fps)]
            stamp = begun + round(k * NS / self.fps)
            feed.emit(Chunk(np.array([stamp]), frames[k % len(frames)][None], stamp), "depth")


def _children_mib() -> float:
    """What all processes that this one has started hold, in MiB."""
    pages, found = 0, {os.getpid()}
    parents = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue  # it has just ended
    while more := {child for child, parent in parents.items() if parent in found and child not in found}:
        found |= more
        for child in more:
            try:
                pages += int(Path(f"/proc/{child}/statm").read_text().split()[1])
            except OSError:
                continue
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def config(folder: Path, hours: float, fps: float, port: int) -> Path:
    """The shipped graph with this camera, and without its switches."""
    graph: Any = read_expanded(CONFIG).plain()
    nodes = graph["nodes"]
    for name in ("pause_switch", "lights", "seen"):
        del nodes[name]
    nodes["camera"] = {"use": "bench.bedside_hours.Hours", "hours": hours, "fps": fps, "deadline_s": 600}
    nodes["bedside.simplify"]["from"] = "camera.depth"
    nodes["night.nights"]["from"] = {"bed": "bedside.presence"}
    nodes["night.log"]["from"].pop("lights")
    nodes["home"]["broker"] = {"host": "127.0.0.1", "port": port}
    path = folder / "bedside.yaml"
    with path.open("w", encoding="utf-8") as file:
        YAML().dump(graph, file)
    return path


def measured(hours: float, fps: float, folder: Path) -> Section:
    """So many hours through the graph."""
    command = [sys.executable, "-c", "from kinegraph.stream.cli.main import main; main()", "run", "bedside.yaml"]
    environment = {**os.environ, "PYTHONPATH": str(HOUSE), "OMP_NUM_THREADS": "1"}
    with broker(folder) as mosquitto, (folder / "log.txt").open("w") as log:
        config(folder, hours, fps, mosquitto.port)
        code = subprocess.run(
            [*command, "-o", "session", "--view", "none"], cwd=folder, env=environment, stdout=log, stderr=log
        ).returncode
    if code:
        raise SystemExit((folder / "log.txt").read_text()[-3000:])
    facts = json.loads((folder / FACTS).read_text(encoding="utf-8"))
    return section(facts["notes"], facts["slices"], fps, logged(folder))


def logged(folder: Path) -> str:
    """What the night's log has: that the graph really did its work."""
    nights = list(archive.nights(folder / "nights"))
    if not nights:
        return "No night was logged."
    epochs = archive.read_epochs(nights[0][0])
    states = epochs.texts["state"].tolist()
    drawn = "with" if (nights[0][0] / "report.html").exists() else "without"
    counts = ", ".join(f"{states.count(name)} {name}" for name in ("sleep", "wake", "unknown"))
    return f"The night's log: {counts}; {drawn} a report."


def section(notes: list[dict[str, float]], slices: list[float], fps: float, about: str) -> Section:
    """The table, hour by hour, and the goals."""
    header = ["hours", "ms of processor time a frame", "memory of the process (MiB)", "of its children (MiB)"]
    rows = []
    for before, note in zip([None, *notes], notes, strict=False):
        ms = (
            ""
            if before is None
            else short(1000 * (note["cpu_s"] - before["cpu_s"]) / (note["frames"] - before["frames"]))
        )
        rows.append([f"{note['hours']:g}", ms, f"{note['mib']:.1f}", f"{note['children_mib']:.1f}"])
    made = Section(f"The shipped graph, {WIDTH} x {HEIGHT} at {fps:g} frames per second", header, rows, [about])
    last = notes[-1]
    if fps == MAX_FPS:
        low, middle = np.percentile(slices, (10, 50))
        made.notes.append(
            f"Processor time a frame with somebody in bed, by slices of {SLICE_S:g} s: {middle:.2f} ms in the median, {low:.2f} in the "
            "tenth percentile. Work of others on the machine makes it longer, never shorter."
        )
        made.goals.append(Goal("processor time a frame, median", round(float(middle), 2), 1.2, "ms"))
    if len(notes) > 3:
        growth = (last["mib"] - notes[1]["mib"]) / (len(notes) - 2)
        made.goals.append(Goal("growth of its memory an hour, after the first", round(growth, 2), 1, "MiB"))
    return made


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.bedside_hours", description=__doc__)
    parser.add_argument("--hours", type=float, default=10.0, help="0: only the half hour")
    parser.add_argument("--fps", type=float, default=5.0, help="of the ten hours")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/lab/bedside.md")
    given = parser.parse_args()
    sections = []
    for hours, fps in ((0.5, float(MAX_FPS)), (given.hours, given.fps)):
        if hours:
            with tempfile.TemporaryDirectory() as name:
                sections.append(measured(hours, fps, Path(name)))
                print(sections[-1].markdown(), file=sys.stderr, flush=True)
    about = f"{ABOUT} Load average at the end: {os.getloadavg()[0]:.1f}, on {os.cpu_count()} cores."
    print(whole(sections, about))
    if given.write:
        publish(sections, about, "lab/bedside.md", *marks("bench.bedside_hours"))


if __name__ == "__main__":
    main()
