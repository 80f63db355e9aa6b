"""`python -m bench.naming`: how often an exercise that one person showed is named right when another does it; Markdown.

Needs the folder of recordings that KINEGRAPH_DATA names: twelve exercises, done by two people (one of them twice). The repetitions that are
found in one recording teach, each by the exercise that was annotated for most of it; those found in another are named. Open set: each
exercise in turn is not taught, and should be `unknown`; then each is taught by itself. `--write` puts the tables into
docs/lab/segmentation-figures.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from itertools import permutations, product
from pathlib import Path

import numpy as np

from bench.motion import Series, events, poses
from bench.report import Section, marks, publish, whole
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.names.taught import UNKNOWN, Taught, taught
from kinegraph.stream.chunk import Samples
from kinegraph.stream.errors import KinegraphError

Shown = dict[str, list[Samples]]
"""The repetitions (n, features) found in a recording, by the exercise that they are."""
Sets = dict[str, dict[str, tuple[Shown, float]]]
"""By kind and recording: what is found there, and the radius that it was found with."""


def repetitions(features: Series, path: Path) -> tuple[Shown, float]:
    """And the median radius with which they were found."""
    with np.load(path) as archive:
        labels, names = archive["label"], [str(name) for name in archive["label_names"]]
        every_s = 1.0 / float(archive["rate"])
    result = events(features, Segment())
    found: Shown = {}
    for event in result["primitive"][result["primitive"]["repetition"] > 0]:
        first, last = np.searchsorted(features.stamps, [event["onset"], event["end"] + 1])
        span = (np.array([event["onset"], event["end"]]) / 1e9 / every_s).astype(int)
        mine = labels[span[0] : span[1] + 1]
        mine = mine[mine >= 0]
        if len(mine) and last - first > 1:
            name = names[int(np.bincount(mine).argmax())]
            found.setdefault(name, []).append(np.ascontiguousarray(features.data[first:last]))
    return found, float(np.median(result["radius"]["radius"])) if len(result["radius"]) else 0.0


def named(model: Taught, done: Shown) -> list[tuple[str, str]]:
    """Of every repetition what it is and what it is called."""
    return [(name, model.call(model.distances(x))[0]) for name, all_ in done.items() for x in all_]


def compare(shown: Shown, radius: float, done: Shown) -> list[str]:
    """Right, wrong and unknown of the repetitions with a shown exercise; unknown of those with an exercise left out."""
    both = sorted(set(shown) & set(done))
    names = named(taught([(name, shown[name]) for name in shown], radius), {name: done[name] for name in both})
    right = sum(name == called for name, called in names)
    unknown = sum(called == UNKNOWN for _, called in names)
    left = []
    for name in both:
        rest = [(other, shown[other]) for other in shown if other != name]
        if rest:
            left += [called == UNKNOWN for _, called in named(taught(rest, radius), {name: done[name]})]
    chance = 1.0 / max(1, len(shown))
    return [
        str(len(both)), str(len(names)), f"{right / max(1, len(names)):.0%}", f"{(len(names) - right - unknown) / max(1, len(names)):.0%}",
        f"{unknown / max(1, len(names)):.0%}", f"{np.mean(left):.0%}" if left else "–", f"{chance:.0%}",
    ]  # fmt: skip


def exercises(folder: Path) -> Sets:
    sets: Sets = {}
    for kind, name, pose, _ in poses(folder):
        if kind.startswith("exercises"):
            print(f"{kind}: {name} ...", file=sys.stderr, flush=True)
            sets.setdefault(kind, {})[name.partition("_12ch")[0]] = repetitions(
                pose.through(Stack()), folder / "mocap6" / f"{name}.npz"
            )
    return sets


def naming(sets: Sets) -> Section:
    rows = []
    for kind, found in sets.items():
        for one, other in permutations(found, 2):
            owner = "the same person" if one[:2] == other[:2] else "another person"
            shown, radius = found[one]
            try:
                rows.append([f"{kind}: {one}", f"{other}, {owner}", *compare(shown, radius, found[other][0])])
            except KinegraphError as error:
                rows.append([f"{kind}: {one}", f"{other}, {owner}", str(error), *[""] * 6])
    head = [
        "shown in", "named in", "exercises in both", "repetitions", "right", "wrong", "unknown", "unknown if not shown", "right by chance",
    ]  # fmt: skip
    return Section("Names across people", head, rows)


def alone(sets: Sets) -> Section:
    """Every name taught by itself: nothing competes with it then, and all else should be unknown."""
    rows = []
    for kind, found in sets.items():
        right, wrong = [], []
        for one, other in product(found, repeat=2):
            shown, radius = found[one]
            for name in shown:
                try:
                    model = taught([(name, shown[name])], radius)
                except KinegraphError:
                    continue
                for what, called in named(model, found[other][0]):
                    if what != name:
                        wrong.append(called == name)
                    elif one != other:
                        right.append(called == name)
        rows.append([kind, str(len(right)), str(sum(right)), str(len(wrong)), str(sum(wrong))])
    head = [
        "",
        "repetitions of the taught exercise, in other recordings",
        "of these named",
        "repetitions of others",
        "called by the taught name",
    ]
    return Section("One name alone", head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.naming", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `segmentation`")
    sets = exercises(folder)
    sections = [naming(sets), alone(sets)]
    print(whole(sections, "By `python -m bench.naming`."))
    if given.write:
        publish(sections, "By `python -m bench.naming`.", "lab/segmentation-figures.md", *marks("bench.naming"))


if __name__ == "__main__":
    main()
