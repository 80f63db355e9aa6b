"""LabJack T-series analog inputs through labjack-ljm and LabJack's LJM library; extra `labjack`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.analog.inputs import AnalogReading, AnalogSource
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed
from kinegraph.stream.system.extras import optional

LOST = -9999.0
"""What LJM puts in the place of a scan that was lost."""
SAME_RATE = 1e-3


@dataclass(frozen=True, slots=True)
class LabJack(AnalogSource):
    """Analog inputs of a LabJack T4, T7 or T8, streamed.

    out      (c,) float64 at `rate_hz`: the inputs, scaled; NaN: a scan that the device lost
    timing   an event per block of 20 ms: running scan number, the device's time by it, arrival, stamp

    The device's clock paces the scans; lost ones keep their places, so that the count stays right. A rate that the device cannot keep
    exactly is refused at the start, with the one that it would use.
    """

    device: str = param("ANY", help="serial number, IP address or name; ANY: the first that is found")
    kind: str = param("ANY", help="T4, T7, T8 or ANY")
    rate_hz: float = param(1000.0, above=0, most=1e5, help="scans per second")

    @staticmethod
    def library() -> Any:
        """labjack.ljm; raises DeviceError that says how to install it, or LabJack's own library."""
        ljm = optional(
            "labjack.ljm", "a LabJack", "pip install 'kinegraph[labjack]', and LabJack's LJM library,", DeviceError
        )
        if ljm.ljm._staticLib is None:
            raise DeviceError(
                "LabJack's own LJM library is not there; install it (labjack.com): labjack-ljm alone is not enough"
            )
        return ljm

    def read(self, feed: Feed) -> None:
        ljm = self.library()
        try:
            handle = ljm.openS(self.kind, "ANY", self.device)
            try:
                self._stream(ljm, handle, feed)
            finally:
                with suppress(ljm.LJMError):
                    ljm.eStreamStop(handle)
                with suppress(ljm.LJMError):
                    ljm.close(handle)
        except ljm.LJMError as error:
            raise DeviceError(f"LabJack {self.device}: {error}") from None

    def _stream(self, ljm: Any, handle: int, feed: Feed) -> None:
        n, names = self.block, [one.input for one in self.inputs]
        for one in self.inputs:
            ljm.eWriteName(handle, f"{one.input}_RANGE", one.range_v)
        addresses = ljm.namesToAddresses(len(names), names)[0]
        rate = ljm.eStreamStart(handle, n, len(names), addresses, self.rate_hz)
        if abs(rate / self.rate_hz - 1) > SAME_RATE:
            raise DeviceError(
                f"LabJack {self.device} would scan at {rate:g} Hz, not {self.rate_hz:g}; write rate_hz: {rate:g}"
            )
        feed.identify("LabJack", name=self.device, inputs=", ".join(names), rate_hz=float(rate))
        feed.ready()
        reading = AnalogReading(self)
        clock_log = ClockLog("LabJack", feed, lambda: reading.pace.state)
        while not feed.stopped:
            volts = np.array(ljm.eStreamRead(handle)[0]).reshape(n, len(names))
            lost = volts == LOST
            if lost.any():
                feed.problem("lost scan", int(lost.any(axis=1).sum()))
                volts[lost] = np.nan
            reading.take(volts, feed)
            clock_log.tell()
