"""Depth frames of a night through the whole graph: how long a frame takes, and what the process's memory does. Part of bench.sleep."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np

from bench.bedside import START, Run, graph
from bench.report import Goal, Section, short
from kinegraph.devices.people.bedroom import Bedroom
from kinegraph.devices.people.bedside import Bedside
from kinegraph.stream.chunk import NS, Array, Chunk

T = TypeVar("T")
WIDTH, HEIGHT, FPS = 640, 480, 30
NIGHT_FRAMES = 864_000
MORNING = """
  nights: {use: operators.sleep.nights.Nights, from: {bed: presence}}
  statistics: {use: operators.sleep.statistics.SleepStatistics, from: {epochs: scorer, periods: nights}}
  night_map:
    use: operators.bed.night_map.NightMap
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
        Goal("depth frame: whole graph of a night", round(ms, 3), 1.5, "ms"),
        Goal("whole graph of a night at 30 fps", round(ms * FPS / 10, 1), 5, "% of a core"),
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
    begin, cpu = time.monotonic(), time.thread_time()
    for k in range(count):
        looped.feed(k)
        if (k + 1) % hour == 0:
            memory.append(resident_mib())
    minutes, cpu = (time.monotonic() - begin) / 60, (time.thread_time() - cpu) / 60
    section = Section(f"A night of {count} frames")
    growth = (memory[-1] - memory[0]) / (len(memory) - 1) if len(memory) > 1 else 0.0
    section.notes = [
        f"{minutes:.1f} minutes, {cpu:.1f} of them processor time; memory in MiB, hour by hour: {', '.join(f'{m:.1f}' for m in memory)} "
        f"(the looped frames alone take {seen.nbytes / 2**20:.0f})."
    ]
    section.goals = [Goal("a night of 864 000 frames", round(minutes * NIGHT_FRAMES / count, 1), 25, "min")]
    if len(memory) > 1:
        section.goals += [
            Goal("growth of its memory an hour, after the first", round(growth, 2), 1, "MiB"),
            Goal("its memory in all", round(memory[-1]), 300, "MiB"),
        ]
    return section


def whole_night(count: int) -> Section:
    """The same with frames of its own."""
    return night(frames(16), count)


def apart(measure: Callable[[int], T], size: int) -> T:
    """`measure(size)` in a process of its own: nothing else has used its memory, and libraries of linear algebra work on one core."""
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure, size).result()
