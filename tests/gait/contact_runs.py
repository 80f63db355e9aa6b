"""What the tests of contacts share."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import contacts as bench
from kinegraph.operators.contacts.contacts import Contacts
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.operator import grid

START = 5 * NS


def feed(
    operator: Contacts[Any],
    spec: StreamSpec,
    data: Array,
    *,
    seconds: Array | None = None,
    lost: dict[int, int] | None = None,
) -> dict[str, list[Chunk]]:
    """All chunks that come out; a new chunk begins wherever `lost` (index: number) says that something is missing."""
    operator.open({"in": spec})
    time = (
        grid(spec.rate_hz or 0.0, len(data), START)
        if seconds is None
        else START + np.round(seconds * NS).astype(np.int64)
    )
    cuts = [0, *sorted(lost or {}), len(data)]
    reported: dict[str, list[Chunk]] = {"touchdown": [], "liftoff": []}
    for begin, end in pairwise(cuts):
        chunk = Chunk(
            time[begin:end], np.ascontiguousarray(data[begin:end]), int(time[end - 1]), (lost or {}).get(begin, 0)
        )
        for name, out in operator.process("in", chunk):
            assert out.until == chunk.until
            assert (out.data["onset"] <= out.time).all()
            reported[name].append(out)
    return reported


def onsets(reported: dict[str, list[Chunk]], name: str) -> Array:
    """Onsets in s after the first sample."""
    return np.concatenate([(chunk.data["onset"] - START) / NS for chunk in reported[name]])


def cycles_of(reported: dict[str, list[Chunk]], contacts: Specs, seconds: float) -> Array:
    """The gait cycles of a ramp at 1000 Hz with the time in s as value, by `Cycles`; its `closed` events."""
    n = round(seconds * 1000)
    spec = StreamSpec((1,), rate_hz=1000.0, channels=("t",), units=("s",))
    inputs = {"signal": spec, **contacts}
    operator, merge = Cycles(longest_s=4.0), Merge(inputs)
    operator.open(inputs)
    signal = Chunk(grid(1000.0, n, START), np.arange(n)[:, None] / 1000.0, FOREVER)
    pieces = [*merge.push("signal", signal)]
    for port, chunks in reported.items():
        for k, chunk in enumerate(chunks):
            until = FOREVER if k + 1 == len(chunks) else chunk.until
            pieces += merge.push(port, Chunk(chunk.time, chunk.data, until, chunk.lost))
    emitted = [out for port, piece in pieces for out in operator.process(port, piece) or ()]
    return np.concatenate([chunk.data for name, chunk in emitted if name == "closed"])


@pytest.fixture(scope="module")
def recordings() -> Path:
    folder = os.environ.get("KINEGRAPH_DATA")
    if not folder:
        pytest.skip("KINEGRAPH_DATA does not name the folder of real recordings")
    return Path(folder)


@pytest.fixture(scope="module")
def walks(recordings: Path) -> dict[str, list[bench.Walk]]:
    return {file.stem: list(bench.walks(file)) for file in bench.people(recordings)}
