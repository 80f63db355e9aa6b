# ruff: noqa: RET503  (a node that returns nothing does not tick; one that returns None does)
"""csp: nodes written by a user, also with its profiler on, which is its way of keeping metrics."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import nullcontext
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from typing import Any

import csp
from csp import ts
from csp.impl.pushadapter import PushInputAdapter
from csp.impl.wiring import py_push_adapter_def
from csp.profiler import Profiler

from bench.work import EVERY, Feed, Sink, cycled, stamps
from bench.worker import PROFILED, STAMPED, serve


@csp.node
def same(x: ts[object]) -> ts[object]:
    if csp.ticked(x):
        return x


@csp.node
def apply(step: object, x: ts[object]) -> ts[object]:
    if csp.ticked(x):
        y = step(x)
        if len(y):
            return y


@csp.node
def apply_stamped(step: object, x: ts[object]) -> ts[object]:
    if csp.ticked(x):
        y = step(x)
        if len(y[0]):
            return y


@csp.node
def count(sink: object, x: ts[object]):
    if csp.ticked(x):
        sink(x[1] if type(x) is tuple else x)


@csp.node
def starter(feed: object, x: ts[object]) -> ts[object]:
    """Takes the time at which the engine starts."""
    with csp.start():
        feed.begin()
    if csp.ticked(x):
        return x


class Device(PushInputAdapter):
    """A thread that pushes what it reads, as a device's driver would."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._thread = threading.Thread(target=self._read, daemon=True)

    def start(self, starttime: datetime, endtime: datetime) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._thread.join()

    def _read(self) -> None:
        for x in self._feed:
            self.push_tick(x)


device = py_push_adapter_def("device", Device, ts[object], feed=object)


@csp.graph
def chain(steps: object, stamped: bool, source: ts[object], sink: object):
    x = source
    for step in steps:
        x = same(x) if step is None else apply_stamped(step, x) if stamped else apply(step, x)
    count(sink, x)


@csp.graph
def paced(steps: object, feed: object, sink: object):
    chain(steps, False, device(feed), sink)


@csp.graph
def replayed(steps: object, stamped: bool, feed: object, data: object, sink: object):
    chain(steps, stamped, starter(feed, csp.curve(object, data)), sink)


class Csp:
    def versions(self) -> dict[str, str]:
        return {"csp": version("csp")}

    def drive(self, style: str, steps: Sequence[Any], feed: Feed, sink: Sink) -> tuple[int, int]:
        with Profiler() if style == PROFILED else nullcontext():
            if feed.paced:
                seconds = feed.count * feed.period_ns / 1e9 + 0.5
                csp.run(paced, list(steps), feed, sink, realtime=True, endtime=timedelta(seconds=seconds))
            else:
                self._replay(list(steps), feed, sink, stamped=style in (STAMPED, PROFILED))
        return EVERY, 0

    def _replay(self, steps: list[Any], feed: Feed, sink: Sink, *, stamped: bool) -> None:
        begin = datetime(2026, 1, 1, tzinfo=UTC).replace(tzinfo=None)
        values = zip(stamps(feed), cycled(feed), strict=True) if stamped else cycled(feed)
        data = [(timedelta(microseconds=i), value) for i, value in enumerate(values)]
        csp.run(replayed, steps, stamped, feed, data, sink, starttime=begin, endtime=timedelta(days=1))


if __name__ == "__main__":
    serve(Csp())
