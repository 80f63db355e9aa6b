"""`python -m bench.sleep`: depth frames to movement, beside numpy and OpenCV on the same frames; a table in Markdown.

Milliseconds a frame of 640 x 480, medians; contenders take turns. OpenCV (`pip install opencv-python-headless`) is left out where it is
not installed. All but the night is part of `python -m bench`, too. `--night` feeds 864 000 frames, looped from memory, through the whole
graph in a process of its own (ten minutes and more), with the time and the process's memory, hour by hour. No recording is made and
nothing is decoded.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from bench.bedside import START, Run, graph
from bench.report import Goal, Section, short, whole
from devices.bedside import Bedside
from devices.simulators.bedroom import Bedroom
from operators.depth.change import change
from operators.depth.simplify import Simplify
from stream.chunk import NS, Array, Chunk, StreamSpec
from stream.operator import grid

WIDTH, HEIGHT, FPS = 640, 480, 30
NIGHT_FRAMES = 864_000
BLOCK = 8
MORNING = """
  nights: {use: operators.sleep.nights.Nights, from: {bed: presence}}
  statistics: {use: operators.sleep.statistics.SleepStatistics, from: {epochs: scorer, periods: nights}}
  night_map:
    use: operators.depth.night_map.NightMap
    from: {map: motion.map, seen: activity.epochs, bed: presence, nights: statistics}
"""
"""With these the graph is the whole one of configs/bedside_sleep.yaml, but for its outlets."""
WARM = 2000
"""Frames before any is timed: more than two epochs, so that everything has happened once."""


def frames(count: int = 64) -> Array:
    """A sleeper's frames (count, 480, 640), with noise and flickering invalid pixels; they can be looped."""
    camera = Bedside(width=WIDTH, height=HEIGHT, fps=FPS, bed_h=0.5)
    room = Bedroom(WIDTH, HEIGHT, camera.plans())
    return np.stack([room.frame(k, 900 + k / FPS) for k in range(count)])


class Numpy:
    """As one writes it: N(t) and D(p) of pixels that are valid in both frames."""

    def __init__(self) -> None:
        self.total = np.zeros((HEIGHT, WIDTH))

    def change(self, a: Array, b: Array) -> float:
        difference = np.abs(a.astype(np.int32) - b)
        difference[(a == 0) | (b == 0)] = 0
        self.total += difference
        return float(difference.sum() / np.count_nonzero((a != 0) & (b != 0)))


class OpenCV:
    """The same with OpenCV's calls."""

    def __init__(self) -> None:
        self.cv2 = one_core()
        self.total = np.zeros((HEIGHT, WIDTH), np.float32)

    def change(self, a: Array, b: Array) -> float:
        cv2 = self.cv2
        mask = cv2.bitwise_and(cv2.compare(a, 0, cv2.CMP_NE), cv2.compare(b, 0, cv2.CMP_NE))
        difference = cv2.copyTo(cv2.absdiff(a, b), mask)
        cv2.accumulate(difference, self.total)
        return float(cv2.sumElems(difference)[0] / cv2.countNonZero(mask))


def one_core() -> Any:
    """OpenCV, with one thread: everything here is measured on one core."""
    import cv2

    cv2.setNumThreads(1)
    return cv2


def blocks_of(frame: Array) -> Array:
    """(blocks, 64) float32, invalid pixels at the block's mean."""
    blocks = frame.reshape(HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)
    blocks = blocks.astype(np.float32)
    valid = blocks > 0
    means = blocks.sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
    return np.where(valid, blocks, means[:, None])


def back(blocks: Array) -> Array:
    """The frame again."""
    frame = blocks.reshape(HEIGHT // BLOCK, WIDTH // BLOCK, BLOCK, BLOCK).swapaxes(1, 2).reshape(HEIGHT, WIDTH)
    return np.clip(frame + 0.5, 1, 65535).astype(np.uint16)


def numpy_fixed(frame: Array, basis: Array) -> Array:
    """A fixed basis (m, 64)."""
    blocks = blocks_of(frame)
    return back(blocks @ basis.T @ basis)


def numpy_pca(frame: Array, components: int) -> Array:
    """The thesis: the components of every frame anew."""
    blocks = blocks_of(frame)
    mean = blocks.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov(blocks, rowvar=False))
    basis = vectors[:, -components:].astype(np.float32)
    return back((blocks - mean) @ basis @ basis.T + mean)


def opencv_pca(frame: Array, components: int) -> Array:
    """The same by cv2.PCACompute."""
    cv2 = one_core()
    blocks = blocks_of(frame)
    mean, vectors = cv2.PCACompute(blocks, mean=None, maxComponents=components)
    return back(cv2.PCABackProject(cv2.PCAProject(blocks, mean, vectors), mean, vectors))


def medians(ways: dict[str, Callable[[int], object]], rounds: int) -> dict[str, float]:
    """Milliseconds of one call of each, taking turns; every call is given its round."""
    took: dict[str, list[int]] = {name: [] for name in ways}
    for k in range(rounds + 2):
        for name, way in ways.items():
            begin = time.perf_counter_ns()
            way(k)
            took[name].append(time.perf_counter_ns() - begin)
    return {name: float(np.median(times[2:])) / 1e6 for name, times in took.items()}


def movement(seen: Array, rounds: int) -> Section:
    """N, D and masking."""
    last, sums, often = seen[0].copy(), np.zeros((HEIGHT, WIDTH), np.uint32), np.zeros((HEIGHT, WIDTH), np.uint16)
    bed = np.array([[24, 180, 432, 280]])
    edges, out = np.array([0, 180, 460, WIDTH]), np.empty(1)
    plain = Numpy()
    n = len(seen)
    ways: dict[str, Callable[[int], object]] = {
        "kinegraph": lambda k: change(seen[k % n], last, bed, edges, 0.2, sums, often, out),
        "numpy": lambda k: plain.change(seen[k % n], seen[(k - 1) % n]),
    }
    if find_spec("cv2") is not None:
        opencv = OpenCV()
        ways["OpenCV"] = lambda k: opencv.change(seen[k % n], seen[(k - 1) % n])
    took = medians(ways, rounds)
    section = Section(f"N(t), D(p) and masking, {WIDTH} x {HEIGHT}", ["", "ms a frame"])
    section.rows = [[name, short(ms)] for name, ms in took.items()]
    if find_spec("cv2") is None:
        section.notes = ["OpenCV is not installed: pip install opencv-python-headless."]
    section.goals = [Goal("N, D and masking", round(took["kinegraph"], 3), 0.15, "ms")]
    return section


def simplification(seen: Array, rounds: int) -> Section:
    """Blocks of 8 x 8, by the number of components."""
    section = Section(f"Simplification, {BLOCK} x {BLOCK}, {WIDTH} x {HEIGHT}, ms a frame", ["components"])
    n = len(seen)
    for components in (1, 2, 16):
        operator, basis = learned(seen, components)
        times = grid(FPS, len(seen) + rounds + 2, START + 60 * NS)

        def ours(k: int, operator: Simplify = operator, times: Array = times) -> object:
            time = times[k : k + 1]
            return operator.process("in", Chunk(time, seen[k % n][None], int(time[0])))

        ways: dict[str, Callable[[int], object]] = {
            "kinegraph, fixed basis": ours,
            "numpy, fixed basis": lambda k, basis=basis: numpy_fixed(seen[k % n], basis),  # type: ignore[misc]
            "numpy, PCA of every frame": lambda k, m=components: numpy_pca(seen[k % n], m),  # type: ignore[misc]
        }
        if find_spec("cv2") is not None:
            ways["OpenCV, PCA of every frame"] = lambda k, m=components: opencv_pca(seen[k % n], m)  # type: ignore[misc]
        took = medians(ways, rounds)
        section.header = ["components", *took]
        section.rows.append([str(components), *(short(ms) for ms in took.values())])
        if components == 2:
            section.goals = [Goal("simplification, M = 2", round(took["kinegraph, fixed basis"], 3), 0.8, "ms")]
    section.notes = ["Ours is the whole operator: the blocks' means, and learning with it."]
    return section


def learned(seen: Array, components: int) -> tuple[Simplify, Array]:
    """The operator with its basis learned, and the basis (m, 64)."""
    operator = Simplify(components=components, learn_s=1.0)
    operator.open({"in": StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), float(FPS), units=("mm",))})
    times = grid(FPS, 120, START)
    for k in range(120):
        operator.process("in", Chunk(times[k : k + 1], seen[k % len(seen)][None], int(times[k])))
    return operator, operator.state.vectors.astype(np.float32)


class Looped:
    """The bedside graph, fed frames from memory as a camera would give them."""

    def __init__(self, seen: Array) -> None:
        self._seen = seen
        self._run = Run(graph(f"width: {WIDTH}, height: {HEIGHT}, fps: {FPS}, bed_h: 0.5", more=MORNING), ())
        self._run.pipeline.begin()

    def feed(self, k: int) -> None:
        stamp = START + round(k * NS / FPS)
        chunk = Chunk(np.array([stamp]), self._seen[k % len(self._seen)][None], stamp)
        self._run.pipeline.feed("camera.depth", chunk)
        if not k % 1000:
            self._run.pipeline.fold()


def whole_graph(seen: Array, rounds: int) -> Section:
    """From the camera to the score: one frame after the other through all operators."""
    looped = Looped(seen)
    took = np.empty(max(rounds, 30) * 10)
    cpu = 0.0
    for k in range(-WARM, len(took)):
        cpu = cpu if k else time.thread_time()
        begin = time.perf_counter_ns()
        looped.feed(k + WARM)
        if k >= 0:
            took[k] = (time.perf_counter_ns() - begin) / 1e6
    ms, worst = 1000 * (time.thread_time() - cpu) / len(took), float(np.quantile(took, 0.99))
    section = Section(f"The whole graph, {WIDTH} x {HEIGHT}")
    section.notes = [
        f"Simplification, bed, presence, motion, activity, score, breathing, night: {short(ms)} ms of processor time a frame on average, "
        f"{short(float(np.median(took)))} ms elapsed in the median, {short(worst)} at the 99th percentile; "
        f"at {FPS} fps {ms * FPS / 10:.1f} % of a core."
    ]
    section.goals = [
        Goal("whole graph", round(ms, 3), 1.5, "ms"),
        Goal("of a core at 30 fps", round(ms * FPS / 10, 1), 5, "%"),
    ]
    return section


def resident_mib() -> float:
    """The memory that this process takes, in MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def night(seen: Array, count: int) -> Section:
    """A night at full rate: how long it takes, and what the process's memory does."""
    looped = Looped(seen)
    hour = 3600 * FPS
    memory = []
    begin = time.monotonic()
    for k in range(count):
        looped.feed(k)
        if (k + 1) % hour == 0:
            memory.append(resident_mib())
    minutes = (time.monotonic() - begin) / 60
    section = Section(f"A night of {count} frames")
    growth = (memory[-1] - memory[0]) / (len(memory) - 1) if len(memory) > 1 else 0.0
    section.notes = [
        f"{minutes:.1f} minutes; memory in MiB, hour by hour: {', '.join(f'{m:.1f}' for m in memory)} "
        f"(the looped frames alone take {seen.nbytes / 2**20:.0f})."
    ]
    section.goals = [Goal("a night of 864 000 frames", round(minutes * NIGHT_FRAMES / count, 1), 25, "min")]
    if len(memory) > 1:
        section.goals += [
            Goal("memory, growth an hour", round(growth, 2), 1, "MiB"),
            Goal("memory in all", round(memory[-1]), 300, "MiB"),
        ]
    return section


def night_apart(count: int) -> Section:
    """The same in a process of its own, whose memory nothing else has used."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_night, count).result()


def _night(count: int) -> Section:
    return night(frames(16), count)


def sections(rounds: int) -> list[Section]:
    """All but the night."""
    seen = frames()
    return [movement(seen, rounds), simplification(seen, max(5, rounds // 4)), whole_graph(seen, rounds)]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.sleep", description=__doc__)
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--night", action="store_true", help="feed a whole night, too")
    parser.add_argument("--frames", type=int, default=NIGHT_FRAMES, help="how many frames that is")
    given = parser.parse_args()
    made = sections(given.rounds)
    if given.night:
        made.append(night_apart(given.frames))
    load = os.getloadavg()[0]
    print(whole(made, f"{platform.processor() or platform.machine()}, load average {load:.1f} at the end."))


if __name__ == "__main__":
    main()
