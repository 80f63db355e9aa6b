"""Chunks that wait in a source's queue enter together: the same samples, stamps, losses and watermarks as one by one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from queue import SimpleQueue

import numpy as np

from kinegraph.stream.chunk import Chunk, StreamSpec, add_lost
from kinegraph.stream.engine.flow.admission import conform, ordered, soundness
from kinegraph.stream.engine.flow.queues import BoundedQueue

COUNTS = (2, 3, 9, 40)


def check_queued(spec: StreamSpec, chunks: Sequence[Chunk]) -> None:
    """Queue a stream's first 2 to 40 chunks, as its source gave them, and compare what enters with the single ones."""
    sound = soundness(spec)
    for count in COUNTS[: 1 + sum(len(chunks) > n for n in COUNTS[:-1])]:
        given = [c if sound(c) else ordered(conform(spec, c))[0] for c in chunks[:count]]
        queue = BoundedQueue("source.out", SimpleQueue(), count, "block")
        for chunk in given:
            queue.put(chunk)
        taken = [chunk for chunk, _, _ in queue.take_together()]
        assert b"".join(c.time.tobytes() for c in taken) == b"".join(c.time.tobytes() for c in given)
        assert b"".join(c.data.tobytes() for c in taken) == b"".join(c.data.tobytes() for c in given)
        assert _losses(taken) == _losses(given)
        assert {c.until for c in taken} <= {c.until for c in given} and all(
            a.until <= b.until for a, b in pairwise(taken)
        )
        for chunk in taken:
            assert chunk.data.dtype == spec.dtype and chunk.data.shape == (len(chunk), *spec.shape)
            assert chunk.time.dtype == np.int64 and chunk.time.flags.c_contiguous


def _losses(chunks: Sequence[Chunk]) -> dict[int, int]:
    """By sample index: how many are missing before it."""
    at, found = 0, dict[int, int]()
    for chunk in chunks:
        if chunk.lost:
            found[at] = add_lost(found.get(at, 0), chunk.lost)
        at += len(chunk)
    return found
