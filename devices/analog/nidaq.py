"""National Instruments' analog inputs through nidaqmx and the NI-DAQmx driver; extra `ni`."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from kinegraph.devices.analog.inputs import AnalogReading, AnalogSource
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed
from kinegraph.stream.system.extras import optional

TIMEOUT_S = 2.0
WIRING = {
    "default": "DEFAULT",
    "differential": "DIFF",
    "single_ended": "RSE",
    "non_referenced": "NRSE",
    "pseudo": "PSEUDO_DIFF",
}
BUFFER_S = 5.0


@dataclass(frozen=True, slots=True)
class NiDaq(AnalogSource):
    """Analog inputs of an NI-DAQmx device (USB-6xxx, PCIe, CompactDAQ): force plates, EMG amplifiers, treadmills, goniometers.

    out      (c,) float64 at `rate_hz`: the inputs, scaled
    timing   an event per block of 20 ms: running sample number, the device's time by it, arrival, stamp

    The device's clock paces the samples; they are counted and mapped onto the session's clock. A buffer that has overflowed ends the
    reading, which begins again behind a gap. A plate's volts become forces in `operators.contacts.force_plate.ForcePlate`.
    """

    device: str = param("Dev1", help="as NI MAX shows it")
    wiring: Literal["default", "differential", "single_ended", "non_referenced", "pseudo"] = param(
        "default", help="how inputs are wired"
    )

    @staticmethod
    def library() -> Any:
        """nidaqmx; raises DeviceError that says how to install it."""
        return optional("nidaqmx", "NI-DAQ", "pip install 'kinegraph[ni]', and NI's own driver, NI-DAQmx,", DeviceError)

    def read(self, feed: Feed) -> None:
        ni = self.library()
        try:
            task = ni.Task()
            try:
                self._set_up(ni, task, feed)
                self._read(ni, task, feed)
            finally:
                with suppress(ni.errors.DaqError):
                    task.stop()
                task.close()
        except ni.errors.DaqNotFoundError:
            raise DeviceError(
                "NI's driver is not there: install NI-DAQmx (ni.com); nidaqmx alone is not enough"
            ) from None
        except ni.errors.DaqError as error:
            raise DeviceError(f"{self.device}: {' '.join(str(error).split())}") from None

    def _set_up(self, ni: Any, task: Any, feed: Feed) -> None:
        kinds = ni.constants
        for one in self.inputs:
            wiring = getattr(kinds.TerminalConfiguration, WIRING[self.wiring])
            task.ai_channels.add_ai_voltage_chan(
                f"{self.device}/{one.input}", terminal_config=wiring, min_val=-one.range_v, max_val=one.range_v
            )
        task.timing.cfg_samp_clk_timing(
            self.rate_hz, sample_mode=kinds.AcquisitionType.CONTINUOUS, samps_per_chan=round(self.rate_hz * BUFFER_S)
        )
        task.start()
        feed.identify("NI-DAQ", name=self.device, inputs=", ".join(one.input for one in self.inputs))
        feed.ready()

    def _read(self, ni: Any, task: Any, feed: Feed) -> None:
        from nidaqmx.stream_readers import AnalogMultiChannelReader

        reader, n = AnalogMultiChannelReader(task.in_stream), self.block
        block = np.empty((len(self.inputs), n))
        reading = AnalogReading(self)
        clock_log = ClockLog(self.device, feed, lambda: reading.pace.state)
        while not feed.stopped:
            reader.read_many_sample(block, n, timeout=TIMEOUT_S + n / self.rate_hz)
            reading.take(block.T.copy(), feed)
            clock_log.tell()
