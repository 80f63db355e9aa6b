"""What a user of kinegraph would write for the bench: an identity, a sink, a device; `TRIAL` holds what is being run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.work import CHANNELS, RATE_HZ, Feed, Sink, cycled, stamps
from kinegraph.stream import source
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.replay import FOLD_EVERY
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import param


def leave(rows: Samples) -> None:
    """Nothing is done with them."""


@dataclass(slots=True)
class Trial:
    """What the graph in this process is given, and where it goes."""

    feed: Feed | None = None
    sink: Sink | None = None
    take: Callable[[Samples], None] = leave
    """Where rows go: nowhere before the feed begins, for the warm-up sends some."""


TRIAL = Trial()


@dataclass(slots=True)
class Nothing:
    """No state."""


@dataclass(frozen=True, slots=True)
class Identity(Operator[Nothing]):
    """Passes on what it gets, in a chunk of its own."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        return Chunk(chunk.time, chunk.data, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class Count(Operator[Nothing]):
    """The end of the chain: hands what comes to the trial's sink."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        TRIAL.take(chunk.data)


@dataclass(frozen=True, slots=True)
class Device(source.Source):
    """Hands out the trial's feed, at its pace."""

    live_pace: bool = param(False)

    @property
    def live(self) -> bool:
        return self.live_pace

    def specs(self) -> Specs:
        return {"out": StreamSpec((CHANNELS,), rate_hz=float(RATE_HZ), units=("uV",))}

    def read(self, feed: source.Feed) -> None:
        trial = TRIAL.feed
        assert trial and TRIAL.sink
        TRIAL.take = TRIAL.sink
        start = feed.now()
        step = NS // RATE_HZ
        feed.ready()
        for i, x in enumerate(trial):
            first = start + i * trial.period_ns
            feed.emit(Chunk(np.arange(first, first + trial.period_ns, step), x, first + trial.period_ns - step))


def feed_all(pipeline: Pipeline, feed: Feed) -> None:
    """Push a whole feed into a pipeline, chunk by chunk, as replay does; like a peer's list of values, the chunks are there before."""
    push = pipeline.entries["device"].send
    chunks = [Chunk(t, x, int(t[-1])) for t, x in zip(stamps(feed), cycled(feed), strict=True)]
    assert TRIAL.sink
    TRIAL.take = TRIAL.sink
    feed.begin()
    for i, chunk in enumerate(chunks):
        push(chunk, time.perf_counter_ns())
        if not i % FOLD_EVERY:
            pipeline.fold()
    pipeline.end("device")
    feed.end()
