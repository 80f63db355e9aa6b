"""Recordings as features, and what is found in them, for the benches: read whole, through the operators that a graph would use."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.people.exerciser import JOINTS, Exerciser, Routine
from kinegraph.operators.features.mirror import Mirror
from kinegraph.operators.features.pose import Pose
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.filters.channels import Select
from kinegraph.operators.filters.gaps import FillGaps
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.found import Found, merged, second_steps
from kinegraph.operators.segmentation.evaluation.truth import Truth, read_truth
from kinegraph.operators.timing.align import Align
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.data.rows import taking
from kinegraph.stream.operator import ANY, Operator, grid

RATE = 30.0


class Series:
    """A stream as a whole: its spec, stamps (n,) ns from 0, samples."""

    def __init__(self, spec: StreamSpec, stamps: Array, data: Array) -> None:
        self.spec, self.stamps, self.data = spec, np.asarray(stamps, np.int64), np.ascontiguousarray(data, np.float64)

    def through(self, *operators: Operator[Any]) -> Series:
        made = self
        for operator in operators:
            made = made.fed(operator, "pose" if ANY in operator.inputs else next(iter(operator.inputs)))
        return made

    def fed(self, operator: Operator[Any], port: str) -> Series:
        """What an operator of one output makes of it."""
        (spec,) = operator.open({port: self.spec}).values()
        take = taking(operator, {port: self.spec})
        made = [
            *chunks(operator.process(port, take(port, Chunk(self.stamps, self.data, int(self.stamps[-1]))))),
            *chunks(operator.close()),
        ]
        return Series(spec, np.concatenate([c.time for c in made]), np.concatenate([c.data for c in made]))

    def part(self, first_s: float, last_s: float) -> Array:
        return self.data[(self.stamps >= first_s * NS) & (self.stamps < last_s * NS)]


def chunks(emitted: Any) -> list[Chunk]:
    if emitted is None:
        return []
    return [emitted] if isinstance(emitted, Chunk) else [chunk for _, chunk in emitted]


def regular(data: Array, rate_hz: float = RATE) -> Series:
    return Series(StreamSpec(data.shape[1:], rate_hz=rate_hz), grid(rate_hz, len(data), 0), data)


def segment(features: Series, operator: Segment | None = None, mirror: Mirror | None = None) -> Found:
    """What is found in stacked features."""
    result = events(features, operator or Segment(), mirror)
    activity, primitive, merge, radii = (result[name] for name in ("activity", "primitive", "merge", "radius"))
    return Found(
        _spans(activity, features),
        activity["transition"],
        _spans(primitive, features),
        merged(primitive["cluster"], zip(merge["cluster"].tolist(), merge["into"].tolist(), strict=True)),
        primitive["repetition"],
        radius=float(np.median(radii["radius"])) if len(radii) else np.nan,
        second=second_steps(primitive),
    )


def events(features: Series, operator: Segment, mirror: Mirror | None = None) -> dict[str, Array]:
    """Everything that the operator tells about stacked features, by output."""
    specs = {"in": features.spec}
    if mirror:
        specs["mirrored"] = mirror.open(specs)["out"]
    found = {name: [np.empty(0, spec.dtype)] for name, spec in operator.open(specs).items()}
    whole = Chunk(features.stamps, features.data, int(features.stamps[-1]))
    made: list[tuple[str, Chunk]] = []
    if mirror:
        images = mirror.process("in", whole)
        for i in range(len(whole)):
            operator.process("mirrored", images.part(i, i + 1))
            made += operator.process("in", whole.part(i, i + 1))
    else:
        made += operator.process("in", whole)
    for name, chunk in [*made, *operator.close()]:
        found[name].append(chunk.data)
    return {name: np.concatenate(parts) for name, parts in found.items()}


def _spans(events: Array, features: Series) -> Array:
    """Start and end in seconds: a segment ends where the next one starts; frames that have no stack belong to the first and last."""
    spans = np.stack([events["onset"], events["end"] + features.spec.period_ns], 1) / NS
    spans[0, 0] = 0.0
    return spans


def poses(folder: Path) -> Iterable[tuple[str, str, Series, Truth]]:
    """(set, name, features at 30 Hz, annotations) of the annotated motion capture."""
    for path in sorted(folder.glob("cmu86_4ch/*.npz")):
        angles = np.rad2deg(np.unwrap(np.deg2rad(np.load(path)["angles_deg"].astype(np.float64)), axis=0))[::4]
        yield "CMU-86, 4 channels", path.stem, regular(angles), read_truth(path)
    for path in sorted([*folder.glob("cmu86_full/*.npz"), *folder.glob("mocap6/1?_??.npz")]):
        kind = "CMU-86, full body" if path.parent.name == "cmu86_full" else "exercises, full body"
        yield kind, path.stem, regular(np.load(path)["e15_cm"]), read_truth(path)
    for path in sorted(folder.glob("mocap6/*12ch*.npz")):
        slow = regular(np.load(path)["x"], 10.0)
        yield "exercises, 12 channels", path.stem, slow.through(Align(rate_hz=RATE)), read_truth(path)


def before_camera(
    exerciser: Exerciser, sets: int, rng: np.random.Generator
) -> tuple[Series, list[tuple[float, float]]]:
    """The joints of somebody's first sets as a depth camera gives them, frames up to 3 ms early or late; from when to when each set is."""
    routine = Routine(exerciser)
    spans = [(float(starts[0]), float(starts[-1])) for starts in map(routine.starts, range(sets))]
    count = int((spans[-1][1] + min(exerciser.pause_s, 5.0) - 0.1) * RATE)
    joints = np.array([routine.joints(k) for k in range(count)])
    stamps = np.round((np.arange(count) / RATE + 0.02 + rng.uniform(-0.003, 0.003, count)) * NS).astype(np.int64)
    return Series(StreamSpec((len(JOINTS), 3), channels=JOINTS, units=("m",)), stamps, joints), spans


def features(joints: Series, *, fills: bool = True) -> Series:
    """What the nodes of segment_kinect make of joints."""
    if fills:
        joints = joints.through(FillGaps(limit_s=0.2))
    return joints.through(Pose(), Align(rate_hz=RATE, max_distance_s=0.2), Stack())


def in_picture(joints: Series) -> Series:
    """What the nodes of count_video and count_landmarks make of joints."""
    body = joints.through(FillGaps(limit_s=0.2), Pose(points="e30", heading=False))
    plane = tuple(name for name in body.spec.channels if not name.endswith(".z"))
    even = body.through(Select(channels=plane), Align(rate_hz=RATE, max_distance_s=0.2))
    return even.through(Lowpass(cutoff_hz=3, order=2, start="first"), Stack())


def kinect(path: Path) -> Series:
    """A Kinect recording's pose at 30 Hz, joints that are lost filled in."""
    with np.load(path) as found:
        joints, names = found["joints_m"].astype(np.float64), tuple(str(name) for name in found["joint_names"])
        stamps = (found["t_us"] - found["t_us"][0]) * 1000
        joints[~found["tracked"] | ~joints.any(axis=(1, 2))] = np.nan
    keep = np.append(True, np.diff(stamps) > 0)
    return Series(StreamSpec(joints.shape[1:], channels=names, units=("m",)), stamps[keep], joints[keep]).through(
        Pose(), Align(rate_hz=RATE, max_distance_s=0.5)
    )
