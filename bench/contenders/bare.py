"""The limits: plain loops over the same kernels, and over numpy and scipy, with no engine at all."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import IO

import numpy as np
from mcap.writer import Writer

from bench.work import CHANNELS, EVERY, WINDOW, Feed, Sink, Step, sos
from bench.worker import KERNELS, RECORDED, serve
from kinegraph.operators.filters.decimate import thin_out
from kinegraph.operators.filters.iir import sections
from kinegraph.operators.filters.moving import moving_mean
from kinegraph.operators.filters.rectify import magnitudes
from kinegraph.stream.chunk import Samples

FLUSH_S, SYNC_S = 0.5, 2.0
"""As our recorder does, by default."""


class Tape:
    """The least that records what comes so that a crash costs half a second: a message a chunk, with its time, in an MCAP file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._writer = file, Writer(file)
        self._writer.start()
        schema = self._writer.register_schema("samples", "", b"")
        self._channel = self._writer.register_channel("samples", "", schema)
        self._due = time.monotonic() + FLUSH_S
        self._sync_due = time.monotonic() + SYNC_S

    def write(self, x: Samples) -> None:
        now = time.time_ns()
        self._writer.add_message(self._channel, now, x.tobytes(), now)
        if (moment := time.monotonic()) >= self._due:
            self._due = moment + FLUSH_S
            self._writer.flush()  # type: ignore[no-untyped-call]
            if moment >= self._sync_due:
                self._sync_due = moment + SYNC_S
                os.fsync(self._file.fileno())


class Bare:
    def versions(self) -> dict[str, str]:
        return {name: version(name) for name in ("numpy", "scipy", "numba")}

    def drive(self, style: str, steps: Sequence[Step | None], feed: Feed, sink: Sink) -> tuple[int, int]:
        if style == KERNELS:
            self._kernels(feed, sink)
        elif style == RECORDED:
            with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
                self._kernels(feed, sink, Tape(file))
        else:
            for x in feed:
                for step in steps:
                    assert step
                    x = step(x)
                    if not len(x):
                        break
                else:
                    sink(x)
        return EVERY, 0

    def _kernels(self, feed: Feed, sink: Sink, tape: Tape | None = None) -> None:
        """Four calls per chunk into memory that is there already: as little as Python can do."""
        coefficients = sos()
        z = np.zeros((len(coefficients), 2, CHANNELS))
        ring, sums, places = np.zeros((WINDOW, CHANNELS)), np.zeros((4, CHANNELS)), np.zeros((2, CHANNELS), np.int64)
        a, b, c, d = (np.empty((feed.chunk, CHANNELS)) for _ in range(4))
        stamps = np.zeros(feed.chunk, np.int64)
        skip = 0
        for x in feed:
            if tape:
                tape.write(x)
            magnitudes(x, a)
            sections(a, coefficients, z, b)
            rows = (len(x) - skip + EVERY - 1) // EVERY
            if rows:
                thin_out(b, skip, EVERY, stamps, c[:rows], stamps)
                out = d[:rows]
                moving_mean(c[:rows], ring, sums, places, stamps[:rows], 0, out, stamps[:rows])
                sink(out)
            skip = (skip - len(x)) % EVERY


if __name__ == "__main__":
    serve(Bare())
