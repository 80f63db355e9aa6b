"""Events of a training session, as a segmentation and the naming of its repetitions tell them."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.operators.segmentation.names.naming import BELIEVED_NAME, REPETITION
from kinegraph.operators.segmentation.outputs import OUTPUTS
from kinegraph.stream.chunk import NS, Chunk, StreamSpec

EVENTS = {name: StreamSpec((), dtype) for name, (dtype, _) in OUTPUTS.items()}
EVENTS |= {"believed": StreamSpec((), BELIEVED_NAME), "repetition": StreamSpec((), REPETITION)}


def event(port: str, stamp_s: float, **fields: Any) -> Chunk:
    """An event of this port at this time; times are given in seconds."""
    made = np.zeros(1, EVENTS[port].dtype)
    for name, value in fields.items():
        made[name] = round(value * NS) if name in ("onset", "end") else value
    time = np.array([round(stamp_s * NS)])
    return Chunk(time, made, int(time[0]))


def training() -> list[tuple[str, Chunk]]:
    """Three squats, named, one of them taken back and reported again; rest; arms under way."""
    parts = [("provisional", event("provisional", 3, onset=1, end=3, activity=1, repetition=0))]
    for k in (1, 2, 3):
        end = 1 + 2 * k
        parts += [
            ("provisional", event("provisional", end, onset=end - 2, end=end, activity=1, repetition=k)),
            ("believed", event("believed", end, activity=1, repetition=k, name="squat", sure=0.8)),
            ("count", event("count", end, activity=1, count=k, certainty=0.5)),
        ]
    parts += [
        ("count", event("count", 8, activity=1, count=2)),
        ("count", event("count", 8.5, activity=1, count=3)),
        (
            "repetition",
            event("repetition", 9, onset=1, end=3, activity=1, repetition=1, name="squat", sure=0.9, duration_s=1.9),
        ),
        (
            "activity",
            event("activity", 10, onset=1, end=7, activity=1, repeats=True, repetitions=3, cluster=0, certainty=0.5),
        ),
        ("resting", event("resting", 10.5, onset=7.5)),
        ("rest", event("rest", 12, onset=7.5, end=12)),
        ("provisional", event("provisional", 16, onset=12, end=16, activity=2, repetition=0)),
        ("count", event("count", 16.5, activity=2, count=1)),
    ]
    return parts
