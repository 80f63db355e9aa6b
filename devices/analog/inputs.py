"""What devices with analog inputs share: channels with a scale, and samples that are counted to be stamped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.pace import DevicePace
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

BLOCK_S = 0.02
"""About this much time is read at once."""


@dataclass(frozen=True, slots=True)
class AnalogInput:
    """One input: its volts times `scale`, plus `offset`, in `unit`."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    input: str = param(help="as the maker calls it: ai0 (NI), AIN0 (LabJack)")
    name: str = param("", help="the channel's name; left out: the input's")
    scale: float = param(1.0, help="factor from volts to the unit")
    offset: float = param(0.0, help="added after the factor")
    unit: str = param("V", unit=True, help="unit of the channel")
    range_v: float = param(10.0, above=0, help="the largest voltage that is expected, in both directions")

    @property
    def channel(self) -> str:
        return self.name or self.input


@dataclass(frozen=True, slots=True)
class AnalogSource(Source):
    """A device with analog inputs paced by its own clock, read in blocks of BLOCK_S."""

    outputs: ClassVar[tuple[str, ...]] = ("out", "timing")

    inputs: tuple[AnalogInput, ...] = param(help="the inputs, in the order of the channels")
    rate_hz: float = param(1000.0, above=0, most=1e6, help="samples per second of each input")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to the driver, if you know it"
    )

    @staticmethod
    def library() -> Any:
        """The maker's library; raises DeviceError that says how to install it."""
        raise NotImplementedError

    @property
    def block(self) -> int:
        """How many samples of each input are read at once."""
        return max(1, round(self.rate_hz * BLOCK_S))

    @property
    def chunk_s(self) -> float:
        return self.block / self.rate_hz

    def specs(self) -> Specs:
        names = tuple(one.channel for one in self.inputs)
        if not names or len(set(names)) != len(names):
            raise ParameterError("inputs", list(names), "at least one input, each with a name of its own")
        units = tuple(one.unit for one in self.inputs)
        out = StreamSpec((len(names),), rate_hz=self.rate_hz, channels=names, units=units)
        return {"out": out, "timing": timing_spec()}

    def missing(self) -> str:
        self.library()
        return ""

    def prepare(self) -> None:
        line_below.prepare()
        self.library()


class AnalogReading:
    """Volts (n, c), block by block, to chunks: samples are counted, as the device's own clock paces them."""

    def __init__(self, of: AnalogSource) -> None:
        self.pace = DevicePace(of.rate_hz, of.latency_s)
        self._scale = np.array([one.scale for one in of.inputs])
        self._offset = np.array([one.offset for one in of.inputs])

    def take(self, volts: Samples, feed: Feed) -> None:
        """A block has come now; NaN: the device lost that sample."""
        arrival = feed.now()
        counted = self.pace.take(len(volts), arrival)
        stamp = counted.stamp
        if counted.astray:
            feed.problem("lost count")
        feed.emit(Chunk(stamp, volts * self._scale + self._offset, int(stamp[-1]), -1 if counted.astray else 0))
        last = slice(-1, None)
        feed.emit(timing_chunk(counted.number[last], counted.device[last], arrival, stamp[last]), "timing")
