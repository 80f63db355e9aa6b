"""A model of the simulated quadruped at work: markers in, the mesh out."""

from __future__ import annotations

from pathlib import Path

from kinegraph.devices.people.quadruped import marked
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec, grid


def steered(path: Path, marks: Samples, names: tuple[str, ...] = tuple(marked())) -> Samples:
    """The mesh (n, vertices, 3) of the model at `path` for markers `marks` (n, m, 3), as the operator gives it."""
    operator = SteerMesh(model=path)
    operator.open({"in": StreamSpec((len(names), 3), rate_hz=30.0, channels=names, units=("m",))})
    chunks = operator.process("in", Chunk(grid(30.0, len(marks)), marks.reshape(len(marks), -1), 0))
    return next(chunk.data for port, chunk in chunks if port == "mesh")
