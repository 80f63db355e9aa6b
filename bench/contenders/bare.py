"""The limits: plain loops over the same kernels, and over numpy and scipy, with no engine at all."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from bench.work import CHANNELS, EVERY, WINDOW, Feed, Sink, Step, sos
from bench.worker import KERNELS, serve
from operators.decimate import thin_out
from operators.iir import sections
from operators.moving import moving_mean
from operators.rectify import magnitudes


class Bare:
    def versions(self) -> dict[str, str]:
        return {name: version(name) for name in ("numpy", "scipy", "numba")}

    def drive(self, style: str, steps: Sequence[Step | None], feed: Feed, sink: Sink) -> tuple[int, int]:
        if style == KERNELS:
            self._kernels(feed, sink)
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

    def _kernels(self, feed: Feed, sink: Sink) -> None:
        """Four calls per chunk into memory that is there already: as little as Python can do."""
        coefficients = sos()
        z = np.zeros((len(coefficients), 2, CHANNELS))
        ring, sums, places = np.zeros((WINDOW, CHANNELS)), np.zeros((4, CHANNELS)), np.zeros((2, CHANNELS), np.int64)
        a, b, c, d = (np.empty((feed.chunk, CHANNELS)) for _ in range(4))
        stamps = np.zeros(feed.chunk, np.int64)
        skip = 0
        for x in feed:
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
