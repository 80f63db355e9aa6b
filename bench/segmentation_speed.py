"""How long a frame takes to segment, beside stumpy's FLOSS and claspy's streaming ClaSP, and an activity to be recognised; thread time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.engines import EngineError, environment
from bench.motion import RATE, chunks
from bench.report import Goal, Section
from kinegraph.operators.features.bundle import Bundle
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.kernels.clusters import keep, recognise
from kinegraph.operators.segmentation.kernels.distances import insert
from kinegraph.stream.chunk import Array, Chunk, StreamSpec
from kinegraph.stream.operator import Operator, grid

CHANNELS, WINDOW_S, FRAMES, CYCLE = 15, 600.0, 9000, 31
"""Channels, stacked to 75 features; the window that is filled before anything is timed; frames timed; frames of a cycle of the stream."""
PEERS = {"stumpy": ("stumpy's FLOSS", ["stumpy"]), "claspy": ("claspy's streaming ClaSP", ["claspy"])}
PEER_FRAMES = 2000
KEPT = (1, 8, 24, 32)
"""How many exemplars are kept when an activity is looked up."""


def speed(*, quick: bool = False) -> Section:
    """Stack and segment 75 features at 30 Hz, one frame at a time from Python."""
    window_s, frames = (15.0, 300) if quick else (WINDOW_S, FRAMES)
    fill = int(window_s * RATE)
    x = five_actions(fill + frames)
    rows, goals, absent = [], [], []
    for bundle, limit in ((False, 0.3), (True, 1.0)):
        took, memory = ours(x, window_s, bundle=bundle)
        name = "kinegraph, bundled" if bundle else "kinegraph"
        rows.append([f"**{name}**", str(CHANNELS), *figures(took[fill:]), f"{memory / 1e6:.1f}"])
        goals.append(Goal(f"{name}: a frame, mean", float(took[fill:].mean()), limit, "ms"))
    for name, (title, packages) in ({} if quick else PEERS).items():
        try:
            found = peer(name, packages, x[: fill + PEER_FRAMES, 0], fill)
            rows.append([f"{title} {found['version']}", "1", *figures(np.array(found["ms"])), ""])
        except EngineError as error:
            absent.append(str(error))
    head = ["", "channels", "mean, ms", "median", "p99", "p99.9", "longest", "memory, MB"]
    notes = [
        f"{frames} frames after the window is full (the others {PEER_FRAMES}), in the thread's own time; load average at the end "
        f"{os.getloadavg()[0]:.1f}. The others take one channel at a time: {CHANNELS} of them are a frame."
    ]
    title = f"A frame of {CHANNELS} channels, stacked to {5 * CHANNELS} features, at 30 Hz; window of {window_s:g} s"
    return Section(title, head, rows, [*notes, *(f"Left out: {why}." for why in absent)], goals)


def five_actions(n: int, seed: int = 0) -> Array:
    """Five cyclic actions in turn, 15 s each, with noise: (n, 15)."""
    rng = np.random.default_rng(seed)
    turn = np.arange(n) * (2 * np.pi / CYCLE)
    kind = (np.arange(n) // 450) % 5
    mix = rng.normal(size=(5, 4, CHANNELS))
    circle = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1)
    x: Array = np.einsum("nk,nkd->nd", circle, mix[kind]) + 0.1 * rng.normal(size=(n, CHANNELS))
    return x


def ours(x: Array, window_s: float, *, bundle: bool) -> tuple[Array, int]:
    """Milliseconds of every frame, and the memory of the operators."""
    operators: list[Operator[Any]] = [
        Stack(),
        *([Bundle(window_s=window_s)] if bundle else []),
        Segment(window_s=window_s),
    ]
    spec = StreamSpec((CHANNELS,), rate_hz=RATE)
    for operator in operators:
        spec = next(iter(operator.open({"in": spec}).values()))
    stamps, took = grid(RATE, len(x)), np.empty(len(x))
    for i in range(len(x)):
        begun = time.thread_time_ns()
        made = [Chunk(stamps[i : i + 1], x[i : i + 1], int(stamps[i]))]
        for operator in operators:
            made = [out for chunk in made for out in chunks(operator.process("in", chunk))]
        took[i] = (time.thread_time_ns() - begun) / 1e6
    return took, sum(operator.memory_bytes for operator in operators)


def many_exemplars(*, quick: bool = False) -> Section:
    """How long it takes to find the exemplar that a new activity is like."""
    rows = []
    for count in (1, 8) if quick else KEPT:
        took = [recognition(count, seed) for seed in range(2 if quick else 9)]
        rows.append([str(count), f"{np.median(took):.2f}"])
    head = ["exemplars kept", "ms"]
    title = f"The exemplar that a new activity is like, among cycles of 50 to 59 frames of {5 * CHANNELS} features"
    return Section(title, head, rows, ["Medians of nine draws, in the thread's own time."])


def recognition(count: int, seed: int) -> float:
    """Milliseconds in which every exemplar is warped."""
    rng, frames = np.random.default_rng(seed), 0
    operator = Segment()
    operator.open({"in": StreamSpec((5 * CHANNELS,), rate_hz=RATE)})
    memory = operator.state.memory.with_room(8)
    memory.radius = 0.475 * np.sqrt(8.0)
    last = np.empty((0, 5 * CHANNELS))
    for kind in range(count):
        last = cycle(seed, kind)
        for row in last:
            frames = insert(memory, row, 0) + 1
        keep(memory, frames - len(last), len(last))
    again = np.concatenate([cycle(seed, count // 2)] * 2)
    for row in again + 0.1 * rng.normal(size=again.shape):
        frames = insert(memory, row, 0) + 1
    first, length = frames - len(again), len(again) // 2
    recognise(memory, first, frames - 1, length)
    begun = time.thread_time_ns()
    slot, _ = recognise(memory, first, frames - 1, length)
    took = (time.thread_time_ns() - begun) / 1e6
    if slot != count // 2:
        raise RuntimeError(f"exemplar {slot} was found instead of {count // 2}")
    return took


def cycle(seed: int, kind: int) -> Array:
    """One cycle of a kind (frames, features)."""
    length = 50 + kind % 10
    turn = np.arange(length) * (2 * np.pi / length)
    mix = np.random.default_rng((seed, kind)).normal(size=(4, 5 * CHANNELS))
    x: Array = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix
    return x


def figures(ms: Array) -> list[str]:
    return [f"{v:.3f}" for v in (ms.mean(), *np.quantile(ms, [0.5, 0.99, 0.999]), ms.max())]


def peer(name: str, packages: list[str], x: Array, fill: int) -> dict[str, Any]:
    """What segmenters.py prints. Raises EngineError where the peer does not install or fails."""
    python = environment(name, packages)
    script = Path(__file__).parent / "contenders" / "segmenters.py"
    with tempfile.TemporaryDirectory() as folder:
        np.save(f"{folder}/x.npy", x)
        command = [str(python), str(script), name, f"{folder}/x.npy", str(fill), str(CYCLE)]
        quiet = {
            "NUMBA_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "PYTHONWARNINGS": "ignore",
        }
        print(f"{name} ...", file=sys.stderr, flush=True)
        done = subprocess.run(command, env=os.environ | quiet, capture_output=True, text=True, check=False)
    if done.returncode:
        raise EngineError(f"{name}: {(done.stderr.strip().splitlines() or ['it ended without a word'])[-1]}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer
