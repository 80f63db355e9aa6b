"""`python -m bench.motion_map [POSES]`: a map of a million made-up poses of 19 markers: opening it, asking it, dragging, memory; Markdown.

Rendering is not in it: times end where a client without a browser has the whole message. `--live` measures only what a pose takes on the
live map, grid and PCA, one pose a chunk, of 100 000: processor time, which other work hardly changes.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from websockets.sync.client import ClientConnection, connect

from bench.report import table
from kinegraph.devices.page.transfer.wire import decode
from kinegraph.operators.maps.motion_map import MotionMap
from kinegraph.operators.maps.pose_map.commands.build import build_index
from kinegraph.operators.maps.pose_map.commands.gather import GatheredPoses
from kinegraph.operators.maps.pose_map.commands.marker_table import MarkerTable
from kinegraph.operators.maps.pose_map.retrieve import QUERY, PoseSearch
from kinegraph.operators.maps.pose_map.som import PoseGrid
from kinegraph.stream.chunk import Chunk, StreamSpec, grid
from kinegraph.stream.domain.pose_map import MotionIndex

MARKERS, RATE_HZ, SEQUENCE = 19, 60.0, 20_000
DRAGS, QUERIES = 150, 40


def sequences(poses: int) -> list[GatheredPoses]:
    """Made-up gaits: each marker swings with its own harmonics, the pace wanders."""
    rng = np.random.default_rng(8)
    names = [f"m{k}" for k in range(MARKERS)]
    made = []
    for number in range(max(1, poses // SEQUENCE)):
        n = min(SEQUENCE, poses)
        phase = np.cumsum(2 * np.pi * (1.2 + 0.3 * np.sin(np.arange(n) / 700 + number)) / RATE_HZ)
        size = rng.uniform(0.05, 0.4, (2, 3 * MARKERS))
        shift = rng.uniform(0, 0.4, (2, 3 * MARKERS))
        x = size[0] * np.sin(phase[:, None] + shift[0]) + 0.3 * size[1] * np.cos(2 * phase[:, None] + shift[1])
        x += 0.01 * rng.normal(size=x.shape)
        made.append(GatheredPoses(f"s{number}", x.astype(np.float32), 0.0, RATE_HZ, {}, ()))
    assert len(names) == MARKERS
    return made


def resident_mb(process: int) -> float:
    status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    return int(re.findall(r"VmHWM:\s+(\d+)", status)[0]) / 1024


def answer(client: ClientConnection, kind: str) -> float:
    """Wait for a message of this kind; the time at which it was there (s)."""
    while decode(client.recv(timeout=300, decode=False))[0]["t"] != kind:
        pass
    return time.perf_counter()


def main(poses: int) -> None:
    rows: list[list[str]] = []
    names = tuple(f"m{k}" for k in range(MARKERS))
    table_of = MarkerTable("m0", "m1", "y", {n: ((n,),) for n in names}, ())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.npz"
        began = time.perf_counter()
        build_index(table_of, sequences(poses), RATE_HZ, 12, 12, 0).write(path, {})
        rows.append(["made once (without reading recordings)", f"{time.perf_counter() - began:.1f} s"])
        rows += served(path, poses)
        rows.append(["a query in the operator alone, median / longest: poses", in_operator(path, poses, 0)])
        rows.append(["... stretches of 1 s", in_operator(path, poses, 60)])
    print(f"{poses} poses of {MARKERS} markers\n")
    print(table(["", ""], rows))


def served(path: Path, poses: int) -> list[list[str]]:
    """`kinegraph motion map` of an index that is there, as a client sees it."""
    command = [sys.executable, "-m", "kinegraph", "motion", "map", str(path), "--page-at", ":0", "--no-token"]
    began = time.perf_counter()
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        url = next(found[1] for line in process.stderr if (found := re.search(r"page: (http\S+)", line)))
        with connect(
            url.replace("http", "ws", 1) + "socket", max_size=None, compression=None, ping_interval=None
        ) as client:
            view = answer(client, "cells") - began
            ready = answer(client, "search") - began
            rng = np.random.default_rng(1)
            drags = []
            for at in range(DRAGS):
                numbers = [(1000 * k + 7 * at) % poses for k in range(12)]
                asked = time.perf_counter()
                client.send(json.dumps({"do": "frames", "numbers": numbers, "ask": 1}))
                drags.append(1000 * (answer(client, "frames") - asked))
            times: dict[int, list[float]] = {0: [], 60: []}
            for length, took in times.items():
                for first in rng.integers(0, poses - 100, QUERIES).tolist():
                    first -= max(0, first % SEQUENCE + length + 1 - SEQUENCE)
                    asked = time.perf_counter()
                    client.send(json.dumps({"do": "near", "first": first, "last": first + length, "count": 20}))
                    took.append(1000 * (answer(client, "near") - asked))
            children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True)
            memory = [
                resident_mb(int(pid))
                for pid in (process.pid, *map(int, children.stdout.split()))
                if Path(f"/proc/{pid}").exists()
            ]
        process.terminate()
    return [
        ["from the command to the last message of the first view", f"{view:.1f} s"],
        ["... to the first query that can be asked", f"{ready:.1f} s"],
        ["a drag of 12 sequences at the WebSocket, median / p99", spread(drags)],
        ["the 20 nearest poses at the WebSocket, median / p99", spread(times[0])],
        ["the 20 nearest stretches of 1 s at the WebSocket, median / p99", spread(times[60])],
        ["most memory: page, queries", ", ".join(f"{mb:.0f} MB" for mb in memory)],
    ]


def spread(took: list[float]) -> str:
    return f"{np.median(took):.1f} ms / {np.quantile(took, 0.99):.1f} ms"


def in_operator(path: Path, poses: int, length: int) -> str:
    search = PoseSearch(MotionIndex.read(path))
    took = []
    for first in np.random.default_rng(2).integers(0, poses - 100, QUERIES).tolist():
        first -= max(0, first % SEQUENCE + length + 1 - SEQUENCE)
        query = np.array([(1, first, first + length, 20, 0.5, 0)], QUERY)[0]
        began = time.perf_counter()
        search.answer(query)
        took.append(1000 * (time.perf_counter() - began))
    return f"{np.median(took[1:]):.1f} ms / {max(took[1:]):.1f} ms"


def live(poses: int = 100_000) -> str:
    """What each pose takes of the operators of the live map."""
    data = np.concatenate([one.poses for one in sequences(poses)])[:poses]
    names = tuple(f"m{k}.{axis}" for k in range(MARKERS) for axis in "xyz")
    spec = StreamSpec((data.shape[1],), rate_hz=RATE_HZ, channels=names, units=("m",))
    stamps = grid(RATE_HZ, len(data))
    rows = []
    for operator in (PoseGrid(), MotionMap()):
        operator.open({"in": spec})
        took = np.empty(len(data))
        for i in range(len(data)):
            chunk = Chunk(stamps[i : i + 1], data[i : i + 1], int(stamps[i]))
            began = time.thread_time()
            made: Any = operator.process("in", chunk)
            for _ in made or ():
                pass
            took[i] = 1e6 * (time.thread_time() - began)
        half = took[len(took) // 2 :]
        rows.append([type(operator).__name__, *(f"{v:.0f}" for v in (half.mean(), *np.quantile(half, (0.5, 0.99))))])
    return table(["us a pose, after 50 000", "mean", "median", "p99"], rows)


if __name__ == "__main__":
    if "--live" in sys.argv:
        sys.exit(print(live()))
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
