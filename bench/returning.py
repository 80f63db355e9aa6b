"""`python -m bench.returning`: is an activity that comes back after ten minutes the same cluster? Markdown.

An annotated session made of takes of many people (MSRC-12): of each take the first half of the repetitions, one take after the other, then
the second halves in another order. So everything comes back, after all the others. Truth: the take. Needs KINEGRAPH_DATA. `--write` puts
the table into docs/lab/neighbours.md.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.emg_session import drive
from bench.motion import RATE, Series, kinect, regular
from bench.report import Section, marks, publish, whole
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.neighbours.returning import Returning
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.found import merged
from kinegraph.operators.segmentation.evaluation.truth import read_truth
from kinegraph.operators.segmentation.outputs import MERGE
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec

SETS = {
    "30 takes, left out": slice(1, None, 2),
    "15 of these": slice(1, None, 4),
    "30 takes, chosen on": slice(0, None, 2),
}
"""Which of the sixty takes; `share` and `nearer` of the operator were chosen on the last row's."""


@dataclass(slots=True)
class Session:
    """features; of each piece its take, begin and end (s); how many takes."""

    features: Series
    take: Array
    spans: Samples
    takes: int


def session(folder: Path, chosen: slice, seed: int = 0) -> Session:
    firsts, seconds = [], []
    for path in sorted(folder.glob("msrc12/*.npz"))[chosen]:
        pose, keys = kinect(path), read_truth(path).keys
        half = float(keys[len(keys) // 2 - 1] + keys[len(keys) // 2]) / 2
        firsts.append(pose.part(0.0, half))
        seconds.append(pose.part(half, np.inf))
    order = np.random.default_rng(seed).permutation(len(seconds))
    pieces = [*firsts, *(seconds[k] for k in order)]
    ends = np.cumsum([len(piece) for piece in pieces]) / RATE
    spans = np.stack([np.append(0.0, ends[:-1]), ends], 1)
    whole_ = regular(np.concatenate(pieces))
    return Session(whole_.through(Stack()), np.append(np.arange(len(firsts)), order), spans, len(firsts))


def known_again(of: Session, middle: Samples, cluster: Array) -> tuple[int, int, int]:
    """Of the takes with repetitions in both halves: how many; how many have one cluster for most of both; and of these, how many share it
    with no other take."""
    piece = np.searchsorted(of.spans[:, 1], middle)
    most = {}
    for k in range(len(of.take)):
        own = cluster[(piece == k) & (cluster >= 0)]
        if len(own):
            most[k] = int(np.bincount(own).argmax())
    again = {int(of.take[k]): k for k in range(of.takes, len(of.take))}
    both = [take for take in range(of.takes) if take in most and again[take] in most]
    same = [take for take in both if most[take] == most[again[take]]]
    alone = [take for take in same if sum(most[other] == most[take] for other in both) == 1]
    return len(both), len(same), len(alone)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.returning", description=__doc__)
    parser.add_argument("--write", action="store_true", help="into docs/lab/neighbours.md")
    given = parser.parse_args()
    sections = [returning(Path(os.environ["KINEGRAPH_DATA"]) / "segmentation")]
    about = "By `python -m bench.returning`."
    print(whole(sections, about))
    if given.write:
        publish(sections, about, "lab/neighbours.md", *marks("bench.returning"))


def segmented(features: Series) -> dict[str, tuple[StreamSpec, Array, Array]]:
    """What the segmentation gives out, with its stamps."""
    operator = Segment()
    specs = operator.open({"in": features.spec})
    made: dict[str, list[Chunk]] = {name: [] for name in specs}
    for name, chunk in [
        *operator.process("in", Chunk(features.stamps, features.data, int(features.stamps[-1]))),
        *operator.close(),
    ]:
        made[name].append(chunk)
    return {
        name: (specs[name], np.concatenate([c.time for c in cs]), np.concatenate([c.data for c in cs]))
        for name, cs in made.items()
        if cs
    }


def returning(folder: Path) -> Section:
    rows = []
    for name, chosen in SETS.items():
        of = session(folder, chosen)
        made = segmented(of.features)
        primitive, merge = made["primitive"][2], made["merge"][2] if "merge" in made else np.empty(0, MERGE)
        pairs = list(zip(merge["cluster"].tolist(), merge["into"].tolist(), strict=True))
        real = primitive["repetition"] > 0
        middle = (primitive["onset"] + primitive["end"])[real] / 2 / NS
        cells = [*known_again(of, middle, merged(primitive["cluster"], pairs)[real])]
        frames = (of.features.spec, of.features.stamps, of.features.data)
        given = {"in": frames, "radius": made["radius"], "primitive": made["primitive"]}
        known = drive(Returning(), given)["known"][2]
        middle = (known["onset"] + known["end"]) / 2 / NS
        cells += known_again(of, middle, known["known"])[1:]
        rows.append([name, f"{of.spans[-1, 1] / 60:.0f}", *map(str, cells), str(int(known["returned"].sum()))])
    head = [
        "session",
        "min",
        "takes found in both halves",
        "one cluster, segmentation alone",
        "of these, no other take's",
    ]
    head += ["one kind, with the index", "of these, no other take's", "clusters known again"]
    return Section("An activity that comes back after all others", head, rows)


if __name__ == "__main__":
    main()
