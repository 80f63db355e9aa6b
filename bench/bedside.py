"""Simulated nights through the graph of the depth operators, in this process and as fast as it goes, held against what really happened.

`python -m bench.bedside --nights 8`: a table, and what simplification changes. It tests what is done with frames; it shows nothing about
sleep. The hypnograms are those of the file psg_hypnograms_walch2019.npz in the folder sleep of KINEGRAPH_DATA, again and again with other
movements where more nights are asked for; without it they are made up.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import table
from kinegraph.devices.people.night import EPOCH_S
from kinegraph.operators.sleep.scorer import SleepScorer
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import grid

START = 1_772_395_200 * NS
"""2026-03-01T20:00:00Z."""
RAW = """
  motion_raw: {use: operators.bed.motion.Motion, from: {regions: bed, frames: camera.depth}, raw: true}
  activity_raw: {use: operators.bed.activity.Activity, from: {bed: presence, motion: motion_raw}}
  scorer_raw: {use: operators.sleep.scorer.SleepScorer, from: activity_raw}
"""
"""The same without simplification."""
KEPT = (
    "camera.truth", "simplify.scene", "bed", "presence", "activity", "activity.epochs", "scorer", "scorer_raw", "breathing",
)  # fmt: skip
STAGES = {0: "W", 1: "N1", 2: "N2", 3: "N3", 4: "N3", 5: "R", -1: "W"}
LEAST_S = 1.0
"""True movement of so long makes an epoch active, as operators.bed.activity.Activity has it."""
OPERATORS = """
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera.depth, components: COMPONENTS, learn_s: 60}
  bed: {use: operators.bed.bed.BedRegion, from: simplify.blocks, sleepers: SLEEPERS, regions: REGIONS}
  presence: {use: operators.bed.presence.Presence, from: {regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.bed.motion.Motion, from: {scene: simplify.scene, regions: bed, frames: simplify}}
  activity: {use: operators.bed.activity.Activity, from: {bed: presence, far: motion.far, motion: motion}}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: activity, channel: FIRST}
  breathing: {use: operators.bed.breathing.Breathing, from: {regions: bed, bed: presence, blocks: simplify.blocks}}
"""


def graph(
    source: str, *, components: int = 1, sleepers: str = "[sleeper]", regions: str = "[]", more: str = ""
) -> Graph:
    """The graph; `source` are the parameters of devices.people.bedside.Bedside as in a YAML mapping."""
    operators = OPERATORS.replace("COMPONENTS", str(components)).replace("SLEEPERS", sleepers)
    operators = operators.replace("REGIONS", regions)
    operators = operators.replace("FIRST", sleepers.strip("[]").split(",")[0])
    return load_text(f"nodes:\n  camera: {{use: devices.people.bedside.Bedside, {source}}}\n{operators}{more}")


class Run:
    """A feed that hands what a source reads straight to a pipeline, and keeps what comes out."""

    def __init__(self, graph: Graph, kept: Iterable[str], start: int = START) -> None:
        """`kept`: edges by name ("motion", "motion.map")."""
        self.graph, self.pipeline, self._start = graph, Pipeline(graph), start
        self._kept: dict[str, list[tuple[Array, Array]]] = defaultdict(list)
        for name in kept:
            node, _, output = name.partition(".")
            wires = self.pipeline.stages[node].edges if node in self.pipeline.stages else self.pipeline.entries
            wire = wires[output or next(iter(wires))] if node in self.pipeline.stages else wires[name]
            wire.observers.append(lambda chunk, name=name: self._kept[name].append((chunk.time, chunk.data)))

    def run(self) -> Run:
        self.graph.nodes["camera"].part.unopened().read(self)  # type: ignore[union-attr]
        for entry in self.pipeline.entries:
            self.pipeline.end(entry)
        self.pipeline.close()
        return self

    def __getitem__(self, name: str) -> Array:
        """All samples of an edge."""
        return np.concatenate([data for _, data in self._kept[name]])

    def time(self, name: str) -> Array:
        return np.concatenate([time for time, _ in self._kept[name]])

    # what a source needs of a feed
    stopped = False

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.pipeline.feed(f"camera.{output}", chunk)

    def now(self) -> int:
        return self._start

    def wait(self, seconds: float) -> bool:
        return False

    def ready(self) -> None: ...

    def listen(self, timeout_s: float) -> str | None:
        return None

    def problem(self, kind: str, count: int = 1) -> None: ...

    again = False

    def tell(self, kind: str, **facts: str | float) -> None: ...

    def device_clock(self, **facts: float) -> None: ...


def kappa(a: Any, b: Any) -> float:
    """Cohen's kappa of two labellings."""
    a, b = np.asarray(a), np.asarray(b)
    labels = np.union1d(a, b)
    shares = np.array([[np.mean(x == label) for label in labels] for x in (a, b)])
    by_chance = float((shares[0] * shares[1]).sum())
    agreed = float(np.mean(a == b))
    return 1.0 if by_chance == 1 else (agreed - by_chance) / (1 - by_chance)


@dataclass(frozen=True, slots=True)
class Agreement:
    """What a night through the graph gave, beside what really happened.

    epochs, unknown      in bed (from lying down to getting up for good), and those of them without a score
    agreed, agreed_raw   kappa with the same scorer on the true movement: simplified frames, frames as they are
    stages               kappa of the scores with the hypnogram (simulated: no validity)
    exits, found, false  true bed exits in the night, those found within an epoch, others that were reported
    still, known, near   epochs in bed without movement, those with a rate of breath, those within 1 per minute of the true one
    """

    epochs: int
    unknown: int
    agreed: float
    agreed_raw: float
    stages: float
    exits: int
    found: int
    false: int
    still: int
    known: int
    near: int
    states: Array
    """(3, n): of the epochs in bed that both have scored, from simplified frames, from frames as they are, of the true movement."""


def true_states(truth: Array) -> Array:
    """The final states of the default scorer on the true movement, epoch by epoch."""
    active = np.where(truth["moved_s"] >= LEAST_S, truth["moved_s"] / EPOCH_S, 0.0)
    active[truth["in_bed_s"] == 0] = 1.0
    scorer = SleepScorer()
    spec = StreamSpec((1,), rate_hz=1 / EPOCH_S, channels=("moved",))
    scorer.open({"in": spec})
    time = grid(1 / EPOCH_S, len(active), int(truth["onset"][0]))
    emitted = scorer.process("in", Chunk(time, active[:, None].copy(), FOREVER))
    events = np.concatenate([chunk.data for _, chunk in emitted])
    states: Array = events["state"][events["final"]]
    return states


def agreement(run: Run) -> Agreement:
    """Hold a night of one sleeper against its truth."""
    truth, night = run["camera.truth"], run.graph.nodes["camera"].part.plans()[0]  # type: ignore[union-attr]
    at = {int(t): k for k, t in enumerate(truth["onset"])}
    seconds = (truth["onset"] - truth["onset"][0]) / NS
    in_bed = (seconds >= night.bed_s) & (seconds + EPOCH_S <= night.up_s)

    def laid(events: Array, field: str, missing: Any) -> Array:
        """A field of events, on the truth's epochs."""
        out = np.full(len(truth), missing)
        for event in events:
            if int(event["onset"]) in at:
                out[at[int(event["onset"])]] = event[field]
        return out

    true = true_states(truth)
    states = {}
    for name in ("scorer", "scorer_raw"):
        events = run[name]
        states[name] = laid(events[events["final"]], "state", "unknown")
    scored = in_bed & (states["scorer"] != "unknown")
    scored_raw = in_bed & (states["scorer_raw"] != "unknown")
    asleep = np.where(truth["stage"] == "W", "wake", "sleep")
    first = int(truth["onset"][0])
    out = [(int(e["onset"]) - first) / NS for e in run["presence"] if e["state"] == "out"]
    out = [s for s in out if night.bed_s + 60 < s < night.up_s - EPOCH_S]
    left = [float(a) for a, _ in night.absent[1:-1]]
    found = sum(any(abs(s - a) <= EPOCH_S for s in out) for a in left)
    breath = run["breathing"]
    rate = laid(breath, "rate", np.nan)
    still = in_bed & (truth["moved_s"] == 0) & (truth["in_bed_s"] == EPOCH_S)
    return Agreement(
        epochs=int(in_bed.sum()),
        unknown=int((in_bed & ~scored).sum()),
        agreed=kappa(states["scorer"][scored], true[scored]),
        agreed_raw=kappa(states["scorer_raw"][scored_raw], true[scored_raw]),
        stages=kappa(states["scorer"][scored], asleep[scored]),
        exits=len(left),
        found=found,
        false=len(out) - found,
        still=int(still.sum()),
        known=int((still & np.isfinite(rate)).sum()),
        near=int((still & (np.abs(rate - truth["breaths"]) <= 1)).sum()),
        states=np.stack([states["scorer"], states["scorer_raw"], true])[:, scored & scored_raw],
    )


def hypnograms(folder: Path, count: int) -> Iterator[tuple[str, str]]:
    """A name and the camera's parameters for each night; real hypnograms are written as CSV into `folder`."""
    data = os.environ.get("KINEGRAPH_DATA", "")
    if not data:
        for seed in range(count):
            yield f"made up {seed}", f"seed: {seed}"
        return
    with np.load(Path(data) / "sleep" / "psg_hypnograms_walch2019.npz") as nights:
        names = [name for name in nights.files if name.endswith("_stage")]
        for seed in range(count):
            name = names[seed % len(names)]
            path = folder / f"{name}.csv"
            rows = [f"{k * 30},{STAGES[int(stage)]}" for k, stage in enumerate(nights[name])]
            path.write_text("\n".join(["onset,stage", *rows]) + "\n", encoding="utf-8")
            again = f" {seed // len(names) + 1}" if seed >= len(names) else ""
            yield name.removesuffix("_stage") + again, f"hypnogram: {path}, seed: {seed}"


def night(source: str, components: int = 1) -> Agreement:
    """One night through the graph, and through it without simplification."""
    return agreement(Run(graph(source, components=components, more=RAW), KEPT).run())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.bedside", description=__doc__)
    parser.add_argument("--nights", type=int, default=4)
    parser.add_argument("--fps", type=float, default=2.0)
    parser.add_argument("--size", type=int, nargs=2, default=(160, 120), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--components", type=int, default=1)
    given = parser.parse_args()
    header = [
        "night",
        "epochs",
        "unknown",
        "kappa",
        "kappa raw",
        "hypnogram",
        "exits",
        "found",
        "false",
        "still",
        "rate known",
        "within 1",
    ]
    rows, nights = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name, source in hypnograms(Path(folder), given.nights):
            size = f"width: {given.size[0]}, height: {given.size[1]}, fps: {given.fps}"
            nights.append(night(f"{source}, {size}", given.components))
            rows.append(row(name, nights[-1]))
            print(" ".join(rows[-1]), file=sys.stderr, flush=True)
    print(table(header, [*rows, row("all", together(nights))]))
    print(f"\n{changed(nights)}")


def together(nights: list[Agreement]) -> Agreement:
    """All nights as one: counts are added, kappas are of all epochs together (of the hypnogram: unknown)."""
    states = np.concatenate([made.states for made in nights], axis=1)
    counts = ("epochs", "unknown", "exits", "found", "false", "still", "known", "near")
    totals = {name: sum(getattr(made, name) for made in nights) for name in counts}
    return Agreement(
        **totals,
        agreed=kappa(states[0], states[2]),
        agreed_raw=kappa(states[1], states[2]),
        stages=np.nan,
        states=states,
    )


def changed(nights: list[Agreement]) -> str:
    """What simplification changes: of all epochs together, and night by night."""
    whole = together(nights)
    by_night = np.array([made.agreed - made.agreed_raw for made in nights])
    otherwise = int((whole.states[0] != whole.states[1]).sum())
    with_it, without = (int((whole.states[k] != whole.states[2]).sum()) for k in (0, 1))
    return (
        f"Simplification changes kappa by {whole.agreed - whole.agreed_raw:+.4f} over all epochs; night by night by "
        f"{by_night.mean():+.4f} on average, from {by_night.min():+.3f} to {by_night.max():+.3f}. It scores {otherwise} of "
        f"{whole.states.shape[1]} epochs otherwise; {with_it} differ from the truth with it, {without} without."
    )


def row(name: str, made: Agreement) -> list[str]:
    """A line of the table."""
    shares = [f"{made.known / max(1, made.still):.1%}", f"{made.near / max(1, made.still):.1%}"]
    kappas = [f"{k:.3f}" if k == k else "" for k in (made.agreed, made.agreed_raw, made.stages)]
    numbers = [str(n) for n in (made.exits, made.found, made.false, made.still)]
    return [name, str(made.epochs), str(made.unknown), *kappas, *numbers, *shares]


if __name__ == "__main__":
    main()
