"""`python -m bench.emg_acc`: repetitions counted from muscles and acceleration together, by the nodes of segment_emg_acc; Markdown.

Needs the folder of recordings that KINEGRAPH_DATA names. No recording there has both, so the acceleration is computed: walks overground
were recorded with four leg muscles and with markers on both legs, and an accelerometer is put on each shank, halfway between knee and
ankle. It turns with the shank and feels gravity. Strides are those of the right foot, by Zeni's offline method on the markers. `--write`
puts the table into docs/lab/segmentation-figures.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt
from structlog.testing import capture_logs

from bench.contacts import zeni
from bench.motion import Series, chunks, events
from bench.report import Section, marks, publish, whole
from bench.sensors import read, told_by
from kinegraph.operators.features.weigh import Weigh
from kinegraph.operators.segmentation import Segment
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.data.rows import taking
from kinegraph.stream.operator import Operator

G = 9.80665
STEP_NS = NS // 10
"""Streams come in turn, so much of each at a time."""
SHORTEST_S = 5.0
MOST_HZ = 10.0
"""Markers are low-passed here, both ways, before they are differentiated twice."""
MUSCLES = ("LT", "LM", "RT", "RM")
"""Tibialis and gastrocnemius of both legs, named so that the graph's weights find them."""
AXES = tuple(f"{leg}.a{axis}" for leg in "LR" for axis in "xyz")
BOTH = ("[A-Z][A-Z]", "*.a?")
"""The graph's weights: of all muscles together, and of all axes."""


def worn(markers: Array, names: tuple[str, ...], rate_hz: float) -> Array:
    """What an accelerometer on each shank feels (n, 6), in g: along the shank, forward, to the side; left, then right."""
    index, whole_path = np.arange(len(markers)), markers.copy()
    for k in range(markers.shape[1]):
        seen = markers[:, k].any(axis=1)
        for a in range(3):
            whole_path[:, k, a] = np.interp(index, index[seen], markers[seen, k, a])
    smooth = sosfiltfilt(butter(4, MOST_HZ, fs=rate_hz, output="sos"), whole_path, axis=0)
    felt = []
    for leg in "LR":
        knee, ankle, toe = (smooth[:, names.index(leg + place)] for place in ("KNE", "ANK", "TOE"))
        place = (knee + ankle) / 2000.0
        acceleration = np.gradient(np.gradient(place, axis=0), axis=0) * rate_hz**2
        acceleration[:, 2] += G
        along = knee - ankle
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        forward = toe - ankle
        forward -= (forward * along).sum(1, keepdims=True) * along
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        felt += [(acceleration * axis).sum(1) / G for axis in (along, forward, np.cross(along, forward))]
    return np.stack(felt, 1)


def part(name: str) -> Operator[Any]:
    """An operator of the shipped graph."""
    operator = read("segment_emg_acc").nodes[name].part
    assert isinstance(operator, Operator)
    return operator.unopened()


def aligned(streams: dict[str, Series]) -> Series:
    """What the graph's `together` makes of its inputs."""
    operator = part("together")
    specs = {port: stream.spec for port, stream in streams.items()}
    (spec,) = operator.open(specs).values()
    take, made = taking(operator, specs), []
    for until in range(STEP_NS, max(int(stream.stamps[-1]) for stream in streams.values()) + 2 * STEP_NS, STEP_NS):
        for port, stream in streams.items():
            first, last = np.searchsorted(stream.stamps, [until - STEP_NS, until])
            piece = Chunk(stream.stamps[first:last], stream.data[first:last], until - 1)
            made += chunks(operator.process(port, take(port, piece)))
    made += chunks(operator.close())
    return Series(spec, np.concatenate([c.time for c in made]), np.concatenate([c.data for c in made]))


def joined(muscles: Series | None, acceleration: Series | None, weights: tuple[float, float]) -> dict[str, Array]:
    """What the graph's nodes tell of muscles, acceleration or both."""
    streams = {}
    if muscles:
        streams["emg"] = muscles.through(part("envelope"))
    if acceleration:
        streams["acc"] = acceleration.through(part("slow"))
    given = dict(zip(BOTH, weights, strict=True))
    only = given if len(streams) == 2 else {BOTH[0] if muscles else BOTH[1]: 1.0}
    features = aligned(streams).through(part("scaled"), Weigh(weights=only), part("stack"))
    segmentation = part("repetitions.segment")
    assert isinstance(segmentation, Segment)
    with capture_logs():
        return events(features, segmentation)


def walks(folder: Path) -> list[tuple[Series, Series, int]]:
    """Of every walk that lasts: its muscles, the acceleration of its shanks, the strides of the right foot."""
    found = []
    for path in sorted(folder.glob("emg_epfl_S*.npz")):
        with np.load(path) as archive:
            names = tuple(str(name) for name in archive["kin_names"])
            for trial in sorted(
                n.removesuffix("_emg") for n in archive.files if n.startswith("T_") and n.endswith("_emg")
            ):
                x, markers = archive[f"{trial}_emg"].astype(np.float64), archive[f"{trial}_kin"].astype(np.float64)
                if len(x) < SHORTEST_S * 1000:
                    continue
                emg = StreamSpec((4,), rate_hz=1000.0, channels=MUSCLES, units=("uV",) * 4)
                acc = StreamSpec((6,), rate_hz=100.0, channels=AXES, units=("g",) * 6)
                felt = worn(markers, names, 100.0)
                down, _ = zeni(markers, names.index("RANK"), names.index("RHIP"))
                found.append(
                    (
                        Series(emg, np.arange(len(x)) * NS // 1000, x),
                        Series(acc, np.arange(len(felt)) * NS // 100, felt),
                        max(0, len(down) - 1),
                    )
                )
    return found


WEIGHTS = ((1.0, 1.0), (1.0, 2.0), (1.0, 4.0), (2.0, 1.0))


def table(folder: Path, most: int = 0) -> Section:
    recordings = walks(folder)[: most or None]
    strides = np.array([n for _, _, n in recordings])
    rows = []

    def add(name: str, results: list[dict[str, Array]]) -> None:
        counted, certain, cuts = [], 0, 0
        for found in results:
            repeats = found["primitive"][found["primitive"]["repetition"] > 0]
            sure = found["activity"]["activity"][found["activity"]["certainty"] > 0.0]
            # a repetition that is found as two steps is one
            one = np.unique(np.stack([repeats["activity"], repeats["repetition"]], 1), axis=0)
            counted.append(len(one))
            certain += int(np.isin(one[:, 0], sure).sum())
            cuts += len(found["activity"])
        error = np.abs(np.array(counted) - strides)
        seconds = sum(len(emg.data) for emg, _, _ in recordings) / 1000
        rows.append(
            [
                name, f"{sum(counted)} of {strides.sum()}", f"{(error <= 1).sum()} of {len(strides)}",
                f"{certain / max(1, sum(counted)):.0%}", f"{60 * cuts / seconds:.0f}",
            ]
        )  # fmt: skip
        print(f"{name}: {list(zip(counted, strides.tolist(), strict=True))}", file=sys.stderr, flush=True)

    with capture_logs():
        add("muscles, by segment_emg", [told_by("segment_emg", "board", emg) for emg, _, _ in recordings])
    add("muscles, by segment_emg_acc", [joined(emg, None, (1.0, 0.0)) for emg, _, _ in recordings])
    add("acceleration, by segment_emg_acc", [joined(None, acc, (0.0, 1.0)) for _, acc, _ in recordings])
    for weights in WEIGHTS:
        named = f"both, {weights[0]:g} to {weights[1]:g}" + (
            " (segment_emg_acc as shipped)" if weights == WEIGHTS[1] else ""
        )
        add(named, [joined(emg, acc, weights) for emg, acc, _ in recordings])
    lasted = [len(emg.data) / 1000 for emg, _, _ in recordings]
    head = ["", "strides counted", "walks within 1", "certain", "activities a minute"]
    note = (
        f"{len(recordings)} walks of {min(lasted):.0f} to {max(lasted):.0f} s and {strides.min()} to {strides.max()} strides of the right"
        " foot. Weights: of all muscles together to all axes together."
    )
    return Section("Leg muscles and the acceleration of the shanks, computed from markers", head, rows, [note])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.emg_acc", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="of two walks, to see that it works")
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "emg"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `emg`")
    sections = [table(folder, 2 if given.quick else 0)]
    print(whole(sections, "By `python -m bench.emg_acc`."))
    if given.write:
        publish(sections, "By `python -m bench.emg_acc`.", "lab/segmentation-figures.md", *marks("bench.emg_acc"))


if __name__ == "__main__":
    main()
