"""The Lab Streaming Layer: from an outlet in another process to an operator, beside a bare pylsl loop.

    python -m bench.lsl

2000 Hz, 16 channels float32, 10 samples at a time over the loopback. The two take turns, each in a process of its own, on one sender.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bench.report import Goal, Section, short, whole
from kinegraph.devices.lsl.network import library
from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.operator import Operator
from kinegraph.stream.system.clock import SessionClock

HOUSE = Path(__file__).resolve().parent.parent
RATE_HZ, CHANNELS, CHUNK = 2000, 16, 10
SOURCE_ID = "kinegraph.bench"
LAST = CHUNK - 1
"""What the first channel of the last sample sent at once holds: its number among them."""
WARM_S = 1.0
"""What comes in the first second is left out."""
GRAPH = f"""
nodes:
  board: {{use: devices.lsl.LslInlet, source_id: {SOURCE_ID}, channels: {CHANNELS}, rate_hz: {RATE_HZ}, unit: uV}}
  noted: {{use: bench.lsl.Noted, from: board}}
"""
BARE, OURS, RECORDED = "bare", "kinegraph", "recorded"
LABELS = {
    BARE: "bare loop: pylsl's pull_chunk into a numpy array",
    OURS: "**kinegraph**, to the operator",
    RECORDED: "**kinegraph**, recording as well",
}


@dataclass(slots=True)
class Nothing:
    """No state."""


@dataclass(frozen=True, slots=True)
class Noted(Operator[Nothing]):
    """Notes how old the last sample of everything that was sent at once is."""

    clock: ClassVar[SessionClock | None] = None
    ages: ClassVar[list[float]] = []

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        if self.clock and len(chunk.time) and (last := chunk.data[:, 0] == LAST).any():
            self.ages.extend((self.clock.now() - chunk.time[last]).tolist())


def send() -> None:
    """The sender: a chunk whenever its last sample is due, stamped with that moment."""
    lsl = library()
    info = lsl.StreamInfo("bench", "EMG", CHANNELS, RATE_HZ, "float32", SOURCE_ID)
    outlet = lsl.StreamOutlet(info)
    data = np.random.default_rng(1).normal(scale=50, size=(CHUNK, CHANNELS)).astype(np.float32)
    data[:, 0] = np.arange(CHUNK)
    print("there", flush=True)
    due = lsl.local_clock()
    while True:
        due += CHUNK / RATE_HZ
        time.sleep(max(0.0, due - lsl.local_clock()))
        outlet.push_chunk(data, lsl.local_clock())


def bare(seconds: float) -> list[float]:
    """Ages (ns) of the last samples of what was sent at once, in the loop that anyone would write."""
    lsl = library()
    (info,) = lsl.resolve_byprop("source_id", SOURCE_ID, 1, 10.0)
    inlet = lsl.StreamInlet(info)
    room = np.empty((1024, CHANNELS), np.float32)
    ages: list[float] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        data, stamps = inlet.pull_chunk(0.2, 1024, dest_obj=room, min_samples=1, as_numpy=True)
        if len(stamps) and (last := data[:, 0] == LAST).any():
            ages += ((lsl.local_clock() - stamps[last]) * 1e9).tolist()
    return ages


def ours(seconds: float, folder: Path | None) -> list[float]:
    """The same in an operator of a whole session."""
    from bench import lsl as module
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.graph.reading.load import load_text

    session = Session(load_text(GRAPH), folder, duration_s=seconds)
    module.Noted.clock = session.clock
    outcome = session.run()
    if outcome.error:
        raise outcome.error
    return module.Noted.ages


def contend(kind: str, seconds: float) -> dict[str, Any]:
    """One turn in this process: ages after the warm-up, and the share of a processor."""
    with tempfile.TemporaryDirectory() as folder:
        began, cpu = time.monotonic(), time.process_time()
        ages = bare(seconds) if kind == BARE else ours(seconds, Path(folder) / "s" if kind == RECORDED else None)
        share = (time.process_time() - cpu) / (time.monotonic() - began)
    skip = round(WARM_S * RATE_HZ / CHUNK)
    return {"ages": ages[skip:], "cpu": share}


def latency(rounds: int, seconds: float) -> Section:
    """Every round gives each of the three `seconds` of real time."""
    ages: dict[str, list[float]] = {kind: [] for kind in LABELS}
    cpu: dict[str, list[float]] = {kind: [] for kind in LABELS}
    with _sender():
        for _ in range(rounds):
            for kind in LABELS:
                answer = _turn(kind, seconds)
                ages[kind] += answer["ages"]
                cpu[kind].append(answer["cpu"])
    q = {kind: np.percentile(ages[kind], [50, 95, 99]) / 1e3 for kind in LABELS}
    section = Section(
        f"Lab Streaming Layer: {RATE_HZ} Hz x {CHANNELS} channels in {CHUNK}-sample chunks, outlet in another process to operator",
        ["", "p50, times bare", "p95, times bare", "p99, times bare", "p50 us", "p95 us", "p99 us", "chunks"],
    )
    for kind, label in LABELS.items():
        ratios = q[kind] / q[BARE]
        section.rows.append([label, *map(short, [*ratios, *q[kind]]), str(len(ages[kind]))])
    section.goals = [
        Goal("LSL outlet to operator, p50 against a bare pylsl loop", q[OURS][0] / q[BARE][0], 1.5, "times"),
        Goal("LSL outlet to operator, p99 against a bare pylsl loop", q[OURS][2] / q[BARE][2], 2.0, "times"),
        Goal(
            "LSL outlet to operator, recorded, p50 against a bare pylsl loop", q[RECORDED][0] / q[BARE][0], 1.5, "times"
        ),
    ]
    return section


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(HOUSE), "KINEGRAPH_LSL": f"machine:bench-{os.getpid()}"}


def _python(call: str) -> list[str]:
    return [sys.executable, "-c", f"import json; from bench import lsl; {call}"]


def _turn(kind: str, seconds: float) -> dict[str, Any]:
    call = f"print('\\n' + json.dumps(lsl.contend({kind!r}, {seconds + WARM_S})))"
    done = subprocess.run(
        _python(call), env=_environment(), stdout=subprocess.PIPE, text=True, check=True, timeout=seconds + 120
    )
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


@contextmanager
def _sender() -> Iterator[None]:
    process = subprocess.Popen(_python("lsl.send()"), env=_environment(), stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout and process.stdout.readline() == "there\n"
        yield
    finally:
        process.kill()
        process.communicate()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.lsl", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0, help="of each turn")
    given = parser.parse_args()
    print(whole([latency(given.rounds, given.seconds)], "The Lab Streaming Layer, in one run."))


if __name__ == "__main__":
    main()
