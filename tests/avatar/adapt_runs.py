"""What the tests of steering_adapt share."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.operator import grid

NAMES, AT = tuple(marked()), np.array(list(marked().values()))
FACES = topology().faces
STRIDE = np.array([walking(k / 24) for k in range(24)])
REFERENCE, HEADING = ("withers", "croup"), ("croup", "withers")


def steered(path: Path, marks: Samples) -> Samples:
    operator = SteerMesh(model=path)
    operator.open({"in": StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("m",))})
    chunks = operator.process("in", Chunk(grid(30.0, len(marks)), marks.reshape(len(marks), -1), 0))
    return next(chunk.data for port, chunk in chunks if port == "mesh")


def pacing(phases: Samples) -> Samples:
    """Markers of a quadruped that moves both legs of a side together, as the model never did."""
    marks = np.array([walking(p)[AT] for p in phases])
    for leg, late in (("fl", 0.0), ("hl", 0.0), ("fr", 0.5), ("hr", 0.5)):
        hoof = marked()[f"hoof_{leg}"]
        foremost = STRIDE[:, hoof, 2].argmax() / len(STRIDE)
        marks[:, NAMES.index(f"hoof_{leg}")] = [walking(p - late + foremost)[hoof] for p in phases]
    return marks
