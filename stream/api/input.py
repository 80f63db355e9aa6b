"""Streams that are given as arrays or recordings, for graphs that never meet a device."""

from __future__ import annotations

from dataclasses import dataclass

from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source


@dataclass(frozen=True, slots=True)
class Input(Source):
    """A signal that only a recording or an array gives: it makes the place at which a graph is fed. It cannot run live."""

    channels: tuple[str, ...] = param(help="names of the channels")
    rate_hz: float | None = param(None, above=0.0, help="nominal rate; left out: irregular")
    units: tuple[str, ...] = param(("",), unit=True, help="one per channel, or one for all")

    def specs(self) -> Specs:
        try:
            return {
                "out": StreamSpec((len(self.channels),), rate_hz=self.rate_hz, channels=self.channels, units=self.units)
            }
        except ValueError as error:
            raise DeviceError(str(error)) from None

    def prepare(self) -> None:
        """Nothing to compile."""

    def read(self, feed: Feed) -> None:
        raise DeviceError(
            "an Input has no device: run the graph on arrays or on a recording, or name a device's source here"
        )
