"""An operator with one input and one output, run over samples that are cut, gapped and spoilt as a test wants."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.data.rows import taking
from kinegraph.stream.operator import grid

RATE = 200.0


def signal_spec(channels=3, rate_hz=RATE, **more):
    return StreamSpec((channels,), rate_hz=rate_hz, **more)


def run(operator, data, *, spec=None, time=None, cuts=(), lost=None):
    """Everything that an operator with one input and one output makes of samples: (spec, stamps, data, {index: lost})."""
    spec = spec or signal_spec(data.shape[1])
    time = grid(spec.rate_hz, len(data)) if time is None else time
    lost = lost or {}
    operator = operator.unopened()
    made = operator.open({"in": spec})["out"]
    take = taking(operator, {"in": spec})
    places = sorted({0, *cuts, *lost, len(data)})
    emitted, stamps, values, marks, pending, rows = [], [], [], {}, 0, None
    for start, stop in pairwise(places):
        until = int(time[stop]) - 1 if stop < len(time) else FOREVER
        chunk = Chunk(time[start:stop], data[start:stop], until, lost.get(start, 0))
        emitted.append(operator.process("in", take("in", chunk)))
    emitted.append(operator.close())
    for given in emitted:
        for chunk in [given] if isinstance(given, Chunk) else [c for _, c in given or ()]:
            assert len(chunk.time) == len(chunk.data)
            assert rows is None or not len(chunk.time) or chunk.time[0] > rows, "a sample at or before a promise"
            rows = chunk.until if rows is None else max(rows, chunk.until)
            pending = chunk.lost or pending
            if len(chunk.time) and pending:
                marks[sum(map(len, stamps))] = pending
                pending = 0
            stamps.append(chunk.time)
            values.append(chunk.data)
            assert chunk.data.dtype == made.dtype and chunk.data.shape[1:] == made.shape
            assert chunk.data.flags.c_contiguous
    return made, np.concatenate(stamps), np.concatenate(values), marks


def noise(n=700, channels=3, seed=0):
    return np.random.default_rng(seed).normal(size=(n, channels)) + 0.7


def same(a, b):
    return np.array_equal(a, b, equal_nan=True)
