"""Hours of a use as fast as they go: what its process holds at the beginning and at the end."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from tests.soak.uses import CONFIGS, Use
from tests.soak.watched import ROOT, Held

LOOK_S = 0.1
WARM = 0.2
"""The share of the run before memory is held to be steady; it begins when the recording does, after every kernel is compiled."""
MOST_KB = 1024.0
BUDGET = re.compile(r"^latency_budget_ms:.*$", re.MULTILINE)
"""Hours that pass in minutes come in large chunks, whatever the graph says of latency."""


@dataclass(slots=True)
class Growth:
    """How far memory rises over the whole run, by a straight line through it; files and threads in the median of its two halves,
    for a file that is open for a moment is no leak."""

    name: str
    hours: float
    took_s: float
    own_mb: float
    grown_kb: float
    files: tuple[int, int]
    threads: tuple[int, int]
    complaints: list[str] = field(default_factory=list)

    @classmethod
    def table(cls, growths: list[Self]) -> str:
        lines = [
            "| use | hours | took, s | memory, MB | grown by, KiB | files open, medians of both halves | threads |"
        ]
        lines.append("|---|--:|--:|--:|--:|--:|--:|")
        for g in growths:
            files, threads = ("{}, {}".format(*pair) for pair in (g.files, g.threads))
            lines.append(
                f"| {g.name} | {g.hours:g} | {g.took_s:.0f} | {g.own_mb:.0f} | {g.grown_kb:.0f} | {files} | {threads} |"
            )
        return "\n".join(lines)


def grown(use: Use, folder: Path, hours: float = 10.0) -> Growth:
    """Run the shipped graph to its end, recording included, and look at its process all the while."""
    folder.mkdir(parents=True)
    shipped = (CONFIGS / use.config).read_text(encoding="utf-8")
    (folder / use.config).write_text(BUDGET.sub("", shipped), encoding="utf-8")
    settings = [word for one in use.hours for word in ("--set", one.format(hours=hours, seconds=hours * 3600))]
    call = [
        sys.executable,
        "-m",
        "kinegraph",
        "run",
        use.config,
        *settings,
        "-o",
        "session",
        "--view",
        "none",
    ]
    looks: list[Held] = []
    began = time.monotonic()
    with (folder / "log.txt").open("wb") as log:
        process = subprocess.Popen(
            call,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        while process.poll() is None:
            recorded = any(path.stat().st_size for path in folder.glob("session/*.mcap"))
            if recorded and (held := Held.by(process.pid)):
                looks.append(held)
            time.sleep(LOOK_S)
    return growth(use, looks, time.monotonic() - began, process.returncode, hours)


def growth(use: Use, looks: list[Held], took_s: float, code: int, hours: float = 10.0) -> Growth:
    own = np.array([held.own_kb for held in looks], float)
    steady = np.arange(len(looks)) >= WARM * len(looks)
    slope = float(np.polyfit(np.flatnonzero(steady), own[steady], 1)[0])
    settled = looks[int(WARM * len(looks)) :]
    half = len(settled) // 2
    files, threads = (
        (int(np.median(values[:half])), int(np.median(values[half:])))
        for values in ([held.files for held in settled], [held.threads for held in settled])
    )
    made = Growth(use.name, hours, took_s, float(np.median(own[steady])) / 1024, slope * len(looks), files, threads)
    if code:
        made.complaints.append(f"{use.name}: {hours:g} hours ended with {code}")
    if made.grown_kb > MOST_KB:
        made.complaints.append(f"{use.name}: memory grew by {made.grown_kb:.0f} KiB in {hours:g} hours")
    if files[1] > files[0] or threads[1] > threads[0]:
        made.complaints.append(
            f"{use.name}: files went from {files[0]} to {files[1]}, threads from {threads[0]} to {threads[1]}"
        )
    return made
