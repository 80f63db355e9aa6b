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
from importlib.util import find_spec
from typing import Any

import numpy as np

from bench.bedside import START
from bench.night import FPS, HEIGHT, NIGHT_FRAMES, WIDTH, apart, frames, whole_graph, whole_night
from bench.report import Goal, Section, short, whole
from kinegraph.operators.bed.frames.change import change
from kinegraph.operators.bed.frames.simplify import Simplify
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.operator import grid

BLOCK = 8


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
    """The thesis: the components of every frame by itself."""
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
    section.goals = [Goal("depth frame: N, D and masking", round(took["kinegraph"], 3), 0.15, "ms")]
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
            section.goals = [
                Goal("depth frame: simplification, M = 2", round(took["kinegraph, fixed basis"], 3), 0.8, "ms")
            ]
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


def sections(rounds: int) -> list[Section]:
    """All but the night."""
    return apart(_sections, rounds)


def _sections(rounds: int) -> list[Section]:
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
        made.append(apart(whole_night, given.frames))
    load = os.getloadavg()[0]
    print(whole(made, f"{platform.processor() or platform.machine()}, load average {load:.1f} at the end."))


if __name__ == "__main__":
    main()
