"""timeflux: nodes under its own scheduler; `own` is timeflux's and timeflux_dsp's nodes on data frames. It keeps no metrics."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd
from timeflux.core.graph import Graph
from timeflux.core.node import Node
from timeflux.core.scheduler import Scheduler
from timeflux.nodes.apply import ApplyMethod
from timeflux.nodes.window import SampleWindow
from timeflux_dsp.nodes.filters import DropRows, IIRFilter

from bench.work import EVERY, RATE_HZ, WINDOW, Feed, Samples, Sink, Step, sos
from bench.worker import OWN, serve

warnings.simplefilter("ignore")


class Source(Node):
    """Gives one chunk at each turn of the scheduler, as an array or as a data frame."""

    def __init__(self, chunks: Iterator[Samples], frames: bool) -> None:
        self._chunks, self._frames, self._rows = chunks, frames, 0
        self.over = False

    def update(self) -> None:
        x = next(self._chunks, None)
        if x is None:
            self.over = True
        elif self._frames:
            start = np.datetime64("2026-01-01", "ns")
            index = start + (np.arange(self._rows, self._rows + len(x)) * (10**9 // RATE_HZ)).astype("timedelta64[ns]")
            self._rows += len(x)
            self.o.data = pd.DataFrame(x, index=index)
        else:
            self.o.data = x


class Apply(Node):
    def __init__(self, step: Step) -> None:
        self._step = step

    def update(self) -> None:
        if self.i.ready():
            self.o.data = self._step(self.i.data)


class Same(Node):
    def update(self) -> None:
        self.o = self.i


class Count(Node):
    def __init__(self, sink: Sink) -> None:
        self._sink = sink

    def update(self) -> None:
        if self.i.ready():
            self._sink(np.asarray(self.i.data))


class Timeflux:
    def versions(self) -> dict[str, str]:
        return {name: version(name) for name in ("timeflux", "timeflux_dsp", "pandas")}

    def drive(self, style: str, steps: Sequence[Step | None], feed: Feed, sink: Sink) -> tuple[int, int]:
        own = style == OWN
        source = Source(iter(feed), own)
        middle: list[Any] = self._own() if own else [Same() if s is None else Apply(s) for s in steps]
        nodes = {str(i): node for i, node in enumerate([source, *middle, Count(sink)])}
        edges = [{"source": str(i), "target": str(i + 1)} for i in range(len(nodes) - 1)]
        path = Graph({"nodes": [{"id": i} for i in nodes], "edges": edges}).traverse()
        scheduler = Scheduler(path, nodes, 0)
        while not source.over:
            scheduler.next()
        return (EVERY, EVERY - 1) if own else (EVERY, 0)

    def _own(self) -> list[Any]:
        return [
            ApplyMethod("numpy.abs"),
            IIRFilter(sos=sos(), rate=RATE_HZ),
            DropRows(EVERY),
            SampleWindow(WINDOW, 1),
            ApplyMethod("numpy.mean", apply_mode="reduce"),
        ]


if __name__ == "__main__":
    serve(Timeflux())
