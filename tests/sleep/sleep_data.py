"""The actigraphy recordings with their makers' labels, and an operator run over whole arrays."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from kinegraph.stream.laws.case_samples import tapes_of
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.play import Player
from kinegraph.stream.operator import Case, Operator

DATA = os.environ.get("KINEGRAPH_DATA", "")


def sleep_file(name: str) -> Path:
    return Path(DATA) / "sleep" / name


def epochs_of(values: Array, t0: str, epoch_s: float, device: str) -> tuple[StreamSpec, Chunk]:
    """Counts as a stream of wrist actigraphy."""
    begin = int(np.datetime64(t0.rstrip("Z"), "ns").astype(np.int64))
    time = begin + np.arange(len(values)) * round(epoch_s * NS)
    spec = StreamSpec(
        (1,), rate_hz=1 / epoch_s, channels=("activity",), units=("counts",), meta={"device": device, "site": "wrist"}
    )
    return spec, Chunk(time, np.asarray(values, np.float64).reshape(-1, 1), int(time[-1]))


def run(operator: Operator[Any], spec: StreamSpec, chunk: Chunk) -> tuple[StreamSpec, Array]:
    """All that comes out of an operator with one input: its spec and the samples."""
    out, _, data = stamped(operator, spec, chunk)
    return out, data


def stamped(operator: Operator[Any], spec: StreamSpec, chunk: Chunk) -> tuple[StreamSpec, Array, Array]:
    """The same with the samples' stamps between them."""
    out = operator.open({"in": spec})["out"]
    parts = []
    for piece in (chunk, Chunk(chunk.time[:0], chunk.data[:0], FOREVER)):
        emitted = operator.process("in", piece)
        parts += [emitted] if isinstance(emitted, Chunk) else [c for _, c in emitted or ()]
    last = operator.close()
    parts += [last] if isinstance(last, Chunk) else [c for _, c in last or ()]
    return out, np.concatenate([p.time for p in parts]), np.concatenate([p.data for p in parts])


def final(events: Array) -> Array:
    return events[events["final"]]


def play(operator: Operator[Any], **inputs: tuple[StreamSpec, Array, Array]) -> Array:
    """All that comes out of an operator fed as the engine feeds it: per port its spec, stamps and samples."""
    case = Case(operator, inputs)
    return Player(case).play(whole(tapes_of(case))).outputs["out"].data
