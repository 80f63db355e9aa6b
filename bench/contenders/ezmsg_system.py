"""ezmsg: units in one process (its fastest way); `own` is ezmsg-sigproc's units. It always counts what is published and received."""

from __future__ import annotations

import asyncio
import warnings
from collections.abc import AsyncGenerator, Sequence
from importlib.metadata import version
from typing import Any

import ezmsg.core as ez
from ezmsg.sigproc.aggregate import AggregateSettings, AggregateUnit, AggregationFunction
from ezmsg.sigproc.butterworthfilter import ButterworthFilter, ButterworthFilterSettings
from ezmsg.sigproc.downsample import Downsample, DownsampleSettings
from ezmsg.sigproc.math.abs import Abs
from ezmsg.sigproc.window import Window, WindowSettings
from ezmsg.util.messages.axisarray import AxisArray
from ezmsg.util.messages.util import replace

from bench.work import EVERY, RATE_HZ, WINDOW, Feed, Sink, Step, cycled
from bench.worker import OWN, serve

warnings.simplefilter("ignore")


class SourceSettings(ez.Settings):
    feed: Any


class Source(ez.Unit):
    SETTINGS = SourceSettings
    OUTPUT = ez.OutputStream(AxisArray)

    @ez.publisher(OUTPUT)
    async def read(self) -> AsyncGenerator[Any, None]:
        feed: Feed = self.SETTINGS.feed
        feed.begin()
        for i, x in enumerate(cycled(feed)):
            if feed.paced:
                if (rest := feed.rest_s(i)) > 0:
                    await asyncio.sleep(rest)
                feed.hand(i)
            axis = AxisArray.TimeAxis(fs=RATE_HZ, offset=i * feed.chunk / RATE_HZ)
            yield self.OUTPUT, AxisArray(x, dims=["time", "ch"], axes={"time": axis})
        feed.end()
        await asyncio.sleep(0.3)
        raise ez.NormalTermination


class StepSettings(ez.Settings):
    step: Any


class Apply(ez.Unit):
    SETTINGS = StepSettings
    INPUT = ez.InputStream(AxisArray)
    OUTPUT = ez.OutputStream(AxisArray)

    @ez.subscriber(INPUT)
    @ez.publisher(OUTPUT)
    async def on_message(self, message: AxisArray) -> AsyncGenerator[Any, None]:
        y = self.SETTINGS.step(message.data)
        if len(y):
            yield self.OUTPUT, replace(message, data=y)


class Same(ez.Unit):
    INPUT = ez.InputStream(AxisArray)
    OUTPUT = ez.OutputStream(AxisArray)

    @ez.subscriber(INPUT)
    @ez.publisher(OUTPUT)
    async def on_message(self, message: AxisArray) -> AsyncGenerator[Any, None]:
        yield self.OUTPUT, message


class Count(ez.Unit):
    SETTINGS = StepSettings
    INPUT = ez.InputStream(AxisArray)

    @ez.subscriber(INPUT)
    async def on_message(self, message: AxisArray) -> None:
        self.SETTINGS.step(message.data)


class Ezmsg:
    def versions(self) -> dict[str, str]:
        return {name: version(name) for name in ("ezmsg", "ezmsg-sigproc")}

    def drive(self, style: str, steps: Sequence[Step | None], feed: Feed, sink: Sink) -> tuple[int, int]:
        source, end = Source(SourceSettings(feed)), Count(StepSettings(sink))
        middle = (
            self._own() if style == OWN else [Same() if step is None else Apply(StepSettings(step)) for step in steps]
        )
        connections: list[tuple[Any, Any]] = []
        before = source.OUTPUT
        for unit in middle:
            own = style == OWN
            connections.append((before, unit.INPUT_SIGNAL if own else unit.INPUT))
            before = unit.OUTPUT_SIGNAL if own else unit.OUTPUT
        connections.append((before, end.INPUT))
        units = {f"U{i}": unit for i, unit in enumerate([source, *middle, end])}
        ez.run(components=units, connections=connections, force_single_process=True)
        return EVERY, 0

    def _own(self) -> list[Any]:
        window = WindowSettings(
            newaxis="win", window_dur=WINDOW * EVERY / RATE_HZ, window_shift=EVERY / RATE_HZ, zero_pad_until="none"
        )
        return [
            Abs(),
            ButterworthFilter(ButterworthFilterSettings(order=4, cutoff=20.0, coef_type="sos")),
            Downsample(DownsampleSettings(factor=EVERY)),
            Window(window),
            AggregateUnit(AggregateSettings(axis="time", operation=AggregationFunction.MEAN)),
        ]


if __name__ == "__main__":
    serve(Ezmsg())
