"""What the tests of segmentation share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.exerciser import JOINTS, Routine
from kinegraph.operators.features.mirror import Mirror
from kinegraph.operators.features.pose import Pose
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.operator import REACH
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.data.rows import taking
from kinegraph.stream.operator import Operator, grid
from tests.motion.reference import Event

RATE = 30.0
QUICK: dict[str, Any] = {"cycle_s": 2.8, "learn_s": 3.0, "window_s": 12.0, "firm_s": 4.0}
FIELDS = {
    "activity": ("onset", "end", "activity", "repetitions", "cluster", "forced", "symmetry"),
    "primitive": ("onset", "end", "activity", "repetition", "cluster", "forced", "side"),
    "bout": ("onset", "end", "activity", "bout", "repetitions", "cluster"),
    "begin": ("onset", "activity"),
    "count": ("activity", "count"),
    "merge": ("cluster", "into"),
    "rest": ("onset", "end"),
    "resting": ("onset",),
    "provisional": ("onset", "end", "activity", "repetition"),
    "radius": (),
}


def played(
    operator: Operator[Any], x: Any, pieces: int = 1, mirror: Mirror | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The events and their stamps, by output, of a recording (n, features) at 30 Hz that comes in so many pieces, or with a mirror."""
    operator = operator.unopened()
    spec = StreamSpec(x.shape[1:], rate_hz=RATE)
    specs = operator.open({"in": spec} | ({"mirrored": mirror.open({"in": spec})["out"]} if mirror else {}))
    time, found = (
        grid(RATE, len(x)),
        {name: ([np.empty(0, spec.dtype)], [np.empty(0, np.int64)]) for name, spec in specs.items()},
    )
    emitted = []
    for part in np.array_split(np.arange(len(x)), len(x) if mirror else pieces):
        if mirror:
            emitted += operator.process(
                "mirrored", mirror.process("in", Chunk(time[part], x[part], int(time[part][-1])))
            )
        emitted += operator.process("in", Chunk(time[part], x[part], int(time[part][-1])))
    for name, chunk in [*emitted, *(operator.close() or [])]:
        found[name][0].append(chunk.data)
        found[name][1].append(chunk.time)
    return {name: np.concatenate(e) for name, (e, _) in found.items()}, {
        name: np.concatenate(t) for name, (_, t) in found.items()
    }


def as_frames(x: Any, events: dict[str, Any], stamps: dict[str, Any]) -> dict[str, list[Event]]:
    """Events as the reference tells them: stamps as frame numbers."""
    time = grid(RATE, len(x))
    found = {}
    for name, fields in FIELDS.items():
        columns = [np.searchsorted(time, events[name][f]) if f in ("onset", "end") else events[name][f] for f in fields]
        rows = [np.searchsorted(time, stamps[name]), *columns]
        found[name] = [tuple(int(v) for v in row) for row in zip(*rows, strict=True)]
    return found


def frames_of(operator: Segment) -> dict[str, int]:
    seconds = {
        "max_lag": REACH * operator.cycle_s, "window": operator.window_s, "learn": operator.learn_s, "quiet": operator.quiet_s,
        "mass": operator.mass_s, "settle": operator.settle_s, "firm": operator.firm_s, "min_band": operator.band_s[0],
        "max_band": operator.band_s[1], "every": 0.5, "rest": operator.rest_s,
    }  # fmt: skip
    frames = {name: round(value * RATE) for name, value in seconds.items()}
    frames["transition"] = min(round(operator.transition_s * RATE), frames["max_lag"])
    return frames | {"firm": max(frames["firm"], 2 * frames["max_lag"])}


def in_events(reference: list[Event]) -> dict[str, list[Event]]:
    """The reference's events by output."""
    found: dict[str, list[Event]] = {name: [] for name in FIELDS}
    for kind, *rest in reference:
        found[kind].append(tuple(rest))
    return found


def motion(seed: int, bad: bool = False, rests: bool = False) -> Any:
    """Cycles of three kinds at changing pace in random turn, with wandering between them, or rests: (n, 6)."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(6):
        n, pace = int(rng.integers(40, 220)), rng.uniform(0.08, 0.35)
        turn = np.cumsum(pace * (1 + 0.2 * np.sin(np.arange(n) * 0.05)))
        kind = int(rng.integers(0, 4))
        if kind < 3:
            mix = np.random.default_rng(kind).normal(size=(4, 6))
            made.append(np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix)
        else:
            made.append(np.cumsum(rng.normal(size=(n, 6)) * 0.15, 0))
        if rests:
            made.append(np.repeat(made[-1][-1:], int(rng.integers(20, 160)), 0))
    x = np.concatenate(made)
    x += 0.05 * rng.normal(size=x.shape)
    if bad:
        x[rng.integers(0, len(x), 5), rng.integers(0, 6, 5)] = np.nan
        x[rng.integers(0, len(x), 12)] = np.nan
        x[len(x) // 2 : len(x) // 2 + 90, 1] = np.inf
        x[rng.random(x.shape) < 0.1] = np.nan
    return x


def chunks_of(emitted: Any) -> list[Chunk]:
    if emitted is None:
        return []
    return [emitted] if isinstance(emitted, Chunk) else [chunk for _, chunk in emitted]


def recording(name: str) -> Any:
    folder = os.environ.get("KINEGRAPH_DATA")
    path = Path(folder or "") / "segmentation" / f"{name}.npz"
    if not folder or not path.exists():
        pytest.skip(f"KINEGRAPH_DATA names no folder that holds segmentation/{name}.npz")
    with np.load(path) as archive:
        return {key: archive[key] for key in archive.files}


def stacked(x: Any) -> Any:
    operator = Stack()
    operator.open({"in": StreamSpec(x.shape[1:], rate_hz=RATE)})
    time = grid(RATE, len(x))
    made = operator.process("in", Chunk(time, np.ascontiguousarray(x, np.float64), int(time[-1])))
    return np.concatenate([chunk.data for chunk in chunks_of(made)])


SHUFFLED = [f"cmu86_4ch/86_{n}" for n in ("01", "03", "07", "09", "11")]
SHUFFLED += ["cmu86_full/86_01", "cmu86_full/86_09", "mocap6/13_29", "mocap6/13_31"]


def seen(routine: Routine, seconds: float) -> Any:
    """The features (n, 75) of what somebody does in this time."""
    x = np.array([routine.joints(i) for i in range(round(RATE * seconds))])
    pose = Pose()
    spec = StreamSpec(x.shape[1:], rate_hz=RATE, channels=JOINTS, units=("m",))
    (port,) = pose.inputs
    pose.open({port: spec})
    time = grid(RATE, len(x))
    take = taking(pose, {port: spec})
    (made,) = chunks_of(pose.process(port, take(port, Chunk(time, x, int(time[-1])))))
    return stacked(made.data)
