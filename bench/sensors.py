"""`python -m bench.sensors`: strides counted from one inertial sensor on a foot or the back, and cycles from leg muscles; Markdown.

Needs the folder of recordings that KINEGRAPH_DATA names. Each recording is a walk there and back with a turn; annotated are the contacts
of both feet, and a stride is from one contact of a foot to the next. `--write` puts the table into docs/lab/segmentation-figures.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from structlog.testing import capture_logs

from bench.motion import RATE, Series, events
from bench.report import Section, marks, publish, whole
from kinegraph.operators.features.rest import SkipRest
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.features.standardise import Standardise
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.operators.filters.resample import Resample
from kinegraph.operators.segmentation import Segment
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.operator import Operator
from kinegraph.stream.text.short_names import whole_name

SHIPPED = "gyroscope (segment_imu, the graph's own nodes)"
HOUSE = Path(__file__).resolve().parent.parent
IMU = StreamSpec(
    (6,), rate_hz=100.0, channels=("ax", "ay", "az", "gx", "gy", "gz"), units=("m/s2",) * 3 + ("rad/s",) * 3
)
SENSORS: dict[str, tuple[slice, tuple[Operator[Any], ...]]] = {
    "accelerometer, rest left out (count_repetitions)": (slice(0, 3), (Stack(), SkipRest(moves=0.3))),
    SHIPPED: (slice(0, 6), ()),
    "accelerometer and gyroscope, standardised": (slice(0, 6), (Standardise(freeze_s=10.0), Stack())),
}
"""Which axes, and what is done to them between resampling and segmentation; SHIPPED: as the graph has it."""
PLACES = {"rf": "right foot", "lf": "left foot", "lb": "lower back"}


@cache
def read(config: str) -> Graph:
    """A shipped graph."""
    return load(HOUSE / "configs" / f"{config}.yaml")


def shipped(config: str, source: str) -> list[tuple[str, Operator[Any]]]:
    """The operators of a shipped graph from this source to its segmentation, each with the port it is fed by: one after another."""
    graph = read(config)
    name = whole_name("segment", graph.nodes)
    chain: list[tuple[str, Operator[Any]]] = []
    while name != source:
        node = graph.nodes[name]
        assert isinstance(node.part, Operator)
        port = "in" if "in" in node.inputs else next(iter(node.inputs))
        chain.append((port, node.part.unopened()))
        name = node.inputs[port].node
    return chain[::-1]


def told_by(config: str, source: str, raw: Series) -> dict[str, Array]:
    """What a shipped graph's own operators, in their order, tell of a recording that takes the place of its source's output."""
    *before, (_, segmentation) = shipped(config, source)
    for port, operator in before:
        raw = raw.fed(operator, port)
    assert isinstance(segmentation, Segment)
    return events(raw, segmentation)


def counted(path: Path) -> list[tuple[str, str, int, int, int]]:
    """Of a person's recordings: place, sensor, strides annotated, repetitions counted, those that are certain."""
    made = []
    with np.load(path) as archive:
        for walk in sorted({name.partition("_")[0] for name in archive.files if name.endswith("_counter")}):
            for short, place in PLACES.items():
                packet, x = (
                    archive[f"{walk}_{short}_counter"].astype(np.int64),
                    archive[f"{walk}_{short}"].astype(np.float64),
                )
                side = "left" if short == "lf" else "right"
                strides = len(archive[f"{walk}_{side}_events"]) - 1
                for sensor, (axes, steps) in SENSORS.items():
                    raw = Series(IMU, np.round((packet - packet[0]) * NS / 100), x)
                    own = sensor == SHIPPED
                    result = told_by("segment_imu", "sensor", raw) if own else chosen(raw, axes, steps)
                    sure = result["activity"]["activity"][result["activity"]["certainty"] > 0.0]
                    repeats = result["primitive"][result["primitive"]["repetition"] > 0]
                    certain = int(np.isin(repeats["activity"], sure).sum())
                    made.append((place, sensor, strides, len(repeats), certain))
    return made


def chosen(raw: Series, axes: slice, steps: tuple[Operator[Any], ...]) -> dict[str, Array]:
    """The events found in these axes, at 30 Hz and below 3 Hz, after `steps`."""
    some = Series(StreamSpec((axes.stop - axes.start,), rate_hz=100.0), raw.stamps, raw.data[:, axes])
    return events(some.through(Lowpass(cutoff_hz=3.0), Resample(rate_hz=RATE), *steps), Segment())


def inertial(folder: Path, most: int = 0) -> Section:
    found = []
    for path in sorted(folder.glob("imu_voisard_*.npz"))[: most or None]:
        print(f"{path.stem} ...", file=sys.stderr, flush=True)
        found += counted(path)
    rows = []
    for place in PLACES.values():
        for sensor in SENSORS:
            mine = np.array([row[2:] for row in found if row[:2] == (place, sensor)])
            strides, count, certain = mine.T
            error = (
                np.abs(count - strides)
                if place != "lower back"
                else np.minimum(np.abs(count - strides), np.abs(count - 2 * strides))
            )
            rows.append(
                [
                    place, sensor, f"{count.sum()} of {strides.sum()}", f"{np.mean(error <= 2):.0%} of {len(mine)}",
                    f"{certain.sum() / max(1, count.sum()):.0%}",
                ]
            )  # fmt: skip
    note = "On the lower back strides or steps count as right. Certain: repetitions of activities with a `certainty` above 0."
    head = ["worn on", "sensor", "strides counted", "recordings within 2", "certain"]
    return Section("Strides from one inertial sensor", head, rows, [note])


def muscles(folder: Path) -> Section:
    """Cuts and repetitions a minute of leg muscles: a treadmill walk, and short walks overground."""
    rows = []
    with np.load(folder / "emg_santuz_tw12.npz") as archive:
        rows.append(emg("treadmill, 13 muscles", archive["emg_uV"].astype(np.float64), len(archive["touchdown_s"]) - 1))
    for path in sorted(folder.glob("emg_epfl_S*.npz")):
        with np.load(path) as archive:
            for name in [n for n in archive.files if n.endswith("_emg")][:2]:
                x = archive[name].astype(np.float64)
                if len(x) > 5000:
                    rows.append(
                        emg(
                            f"overground, 4 muscles: {path.stem.removeprefix('emg_epfl_')} {name.removesuffix('_emg')}",
                            x,
                            -1,
                        )
                    )
    head = ["", "s", "gait cycles", "counted", "certain", "activities a minute", "of them certain", "the log warns"]
    return Section("Leg muscles, by the nodes of segment_emg", head, rows)


def emg(name: str, x: Array, cycles: int) -> list[str]:
    raw = Series(StreamSpec((x.shape[1],), rate_hz=1000.0, units=("uV",)), np.arange(len(x)) * NS // 1000, x)
    with capture_logs() as entries:
        result = told_by("segment_emg", "board", raw)
    activity = result["activity"]
    repeats = result["primitive"][result["primitive"]["repetition"] > 0]
    sure = activity["certainty"] > 0.0
    certain = np.isin(repeats["activity"], activity["activity"][sure]).sum()
    minutes = len(x) / 60000
    return [
        name, f"{len(x) / 1000:.0f}", str(cycles) if cycles >= 0 else "not annotated", str(len(repeats)), str(certain),
        f"{len(activity) / minutes:.0f}", f"{sure.sum() / minutes:.0f}", "yes" if entries else "no",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.sensors", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="of one person, to see that it works")
    parser.add_argument("--write", action="store_true", help="write tables into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", ""))
    if not os.environ.get("KINEGRAPH_DATA") or not (folder / "steps").is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `steps` and `emg`")
    sections = [inertial(folder / "steps", 1 if given.quick else 0), muscles(folder / "emg")]
    print(whole(sections, "By `python -m bench.sensors`."))
    if given.write:
        publish(sections, "By `python -m bench.sensors`.", "lab/segmentation-figures.md", *marks("bench.sensors"))


if __name__ == "__main__":
    main()
