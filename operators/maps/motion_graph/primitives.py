"""The primitives of takes: cut by operators.segmentation, one cluster for what is alike in all takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kinegraph.operators.features.pose import Pose
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.maps.motion_graph.takes import Take
from kinegraph.operators.segmentation.operator import Segment
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec, Times
from kinegraph.stream.data.rows import taking
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.operator import Operator, grid

JOINTS = {
    "root": ("LeftUpperLeg", "RightUpperLeg"),
    "head": ("Head",),
    **{f"{name}_{s}": (f"{side}{bone}",) for name, bone in {"hip": "UpperLeg", "ankle": "Foot", "wrist": "Hand"}.items()
       for s, side in {"l": "Left", "r": "Right"}.items()},
}  # fmt: skip
BETWEEN_S = 5.0
"""Takes stand so far apart in the stream that is segmented: a gap, over which nothing is compared but with exemplars."""


def segmented(tree: JointTree, takes: Sequence[Take], rate_hz: float) -> list[Take]:
    """The same takes with their primitives. Parts that no primitive covers are transitions."""
    spec = StreamSpec((len(BONES), 3), rate_hz=rate_hz, channels=BONES, units=("m",))
    places, begins = [joints_of(tree, take.poses)[1] for take in takes], list[int]()
    at = 0
    stream = list[tuple[Times, Samples]]()
    for joints in places:
        begins.append(at)
        time = grid(rate_hz, len(joints), at)
        stream.append((time, joints))
        at = int(time[-1]) + round(BETWEEN_S * NS)
    features = _through(
        Pose(joints=JOINTS), spec, [Chunk(t, x, int(t[-1]), -1 if k else 0) for k, (t, x) in enumerate(stream)]
    )
    stacks = _through(Stack(), *features)
    primitive, merges = _told(Segment(), *stacks)
    for old, into in zip(merges["cluster"].tolist(), merges["into"].tolist(), strict=True):
        primitive["cluster"][primitive["cluster"] == old] = into
    cut = [spans_of(primitive, begun, len(take.poses), rate_hz) for take, begun in zip(takes, begins, strict=True)]
    return [replace(take, spans=spans, cluster=cluster) for take, (spans, cluster) in zip(takes, cut, strict=True)]


def spans_of(primitive: Array, begun: int, frames: int, rate_hz: float) -> tuple[Times, Times]:
    """`spans` and `cluster` of a take that begins at `begun` (ns), from events with onset, end and cluster."""
    rows: list[tuple[int, int, int]] = []
    at = 0
    order = np.argsort(primitive["onset"], kind="stable")
    for event in primitive[order]:
        first = round((int(event["onset"]) - begun) * rate_hz / NS)
        last = min(round((int(event["end"]) - begun) * rate_hz / NS) + 1, frames)
        first = max(first, at)
        if first >= last or last <= 0:
            continue
        if first > at:
            rows.append((at, first, -1))
        rows.append((first, last, int(event["cluster"])))
        at = last
    if at < frames:
        rows.append((at, frames, -1))
    table = np.array(rows, np.int64).reshape(-1, 3)
    return table[:, :2].copy(), table[:, 2].copy()


def _through(operator: Operator[Any], spec: StreamSpec, given: list[Chunk]) -> tuple[StreamSpec, list[Chunk]]:
    """All that an operator with one input and output makes of a stream."""
    made = operator.open({"in": spec})["out"]
    take = taking(operator, {"in": spec})
    emitted: list[Any] = [operator.process("in", take("in", chunk)) for chunk in given]
    emitted.append(operator.close())
    chunks = list[Chunk]()
    for one in emitted:
        chunks += [] if one is None else [one] if isinstance(one, Chunk) else [chunk for _, chunk in one]
    return made, [chunk for chunk in chunks if len(chunk)]


def _told(operator: Segment, spec: StreamSpec, given: list[Chunk]) -> tuple[Array, Array]:
    """The primitives and the merges of clusters."""
    specs = operator.open({"in": spec})
    events: dict[str, list[Array]] = {name: [np.empty(0, specs[name].dtype)] for name in ("primitive", "merge")}
    for chunk in given:
        for name, part in operator.process("in", chunk):
            if name in events:
                events[name].append(part.data)
    for name, part in operator.close():
        if name in events:
            events[name].append(part.data)
    return np.concatenate(events["primitive"]), np.concatenate(events["merge"])
