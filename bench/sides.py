"""Walking among other actions: are its cycles one cluster that holds nothing else, and which leg makes the step?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.motion import RATE, Series, events, regular
from bench.report import Goal, Section
from kinegraph.operators.features.mirror import Mirror
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.found import merged, second_steps
from kinegraph.operators.segmentation.evaluation.truth import Truth, read_truth
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.operator import grid

POINTS = ("ankle_l", "ankle_r", "head", "wrist_l", "wrist_r")


def sides(folder: Path) -> Section:
    """Per recording of CMU-86 in which somebody walks."""
    rows = []
    for path in sorted(folder.glob("cmu86_full/*.npz")):
        pose = np.load(path)["e15_cm"].astype(np.float64)
        names = tuple(f"{point}.{axis}" for point in POINTS for axis in "xyz")
        spec = StreamSpec((15,), rate_hz=RATE, channels=names)
        mirror = Mirror(swap=(("ankle_l", "ankle_r"), ("wrist_l", "wrist_r")), negate=("*.x",), sides=True)
        rows.append(
            [f"full body: {path.stem}", *_row(Series(spec, grid(RATE, len(pose), 0), pose), mirror, path, pose)]
        )
    for path in sorted(folder.glob("cmu86_4ch/*.npz")):
        angles = np.rad2deg(np.unwrap(np.deg2rad(np.load(path)["angles_deg"].astype(np.float64)), axis=0))[::4]
        rows.append([f"4 channels: {path.stem}", *_row(regular(angles), Mirror((("0", "1"), ("2", "3"))), path)])
    header = ["", "walk cycles", "clusters of theirs", "others in these", "cut into two steps", "swinging foot's side"]
    first = rows[0]
    goals = [
        Goal("86_01: clusters of its walk cycles", float(first[2]), 1, ""),
        Goal("86_01: other repetitions in them", float(first[3]), 0, ""),
    ]
    return Section("Walking among other actions: its clusters and steps", header, rows, goals=goals)


def _row(series: Series, mirror: Mirror, path: Path, pose: Array | None = None) -> list[str]:
    features = series.through(Stack())
    result = events(features, Segment(), mirror)
    found, merge = result["primitive"], result["merge"]
    clusters = merged(found["cluster"], zip(merge["cluster"].tolist(), merge["into"].tolist(), strict=True))
    second = second_steps(found)
    assert second is not None
    cycles = (found["repetition"] > 0) & ~second
    walked = np.array([_label(read_truth(path), e["onset"], e["end"]) for e in found])
    walks = cycles & (walked == "walk")
    mine = np.unique(clusters[walks])
    others = int((cycles & np.isin(clusters, mine) & (walked != "walk") & (walked != "")).sum())
    cut = int((walks & (found["side"] > 0)).sum())
    right = _agree(found[(walked == "walk") & (found["side"] > 0)], pose)
    return [str(int(walks.sum())), str(len(mine)), str(others), str(cut), right]


def _label(truth: Truth, onset: int, end: int) -> str:
    """The action that covers most of a primitive; "" in a transition."""
    shared = np.minimum(truth.end, end / NS) - np.maximum(truth.start, onset / NS)
    k = int(shared.argmax())
    return truth.label[k] if 2 * shared[k] > (end - onset) / NS else ""


def _agree(steps: Array, pose: Array | None) -> str:
    """In how many steps the ankle of the side that is reported goes forward more than the other one."""
    if pose is None:
        return "-"
    ahead = pose[:, 2] - pose[:, 5]
    first, last = (np.round(steps[name] * RATE / NS).astype(int) for name in ("onset", "end"))
    return f"{int(((ahead[last] > ahead[first]) == (steps['side'] == 1)).sum())} of {len(steps)}"
