"""A simulated motion capture system on the Lab Streaming Layer: eight markers on the legs of someone who walks on a treadmill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.lsl.simulator import Lsl
from kinegraph.devices.people.treadmill.signal import Signal
from kinegraph.devices.people.walkway import EMG_HZ, MARKERS, Walkway, WalkwayTrial
from kinegraph.stream.params import param

LABELS = tuple(f"{name}.{axis}" for name in MARKERS for axis in "xyz")


@dataclass(frozen=True, slots=True)
class Mocap(Lsl):
    """An LSL stream of markers on hips, knees, ankles and toes: x to the right, y forwards, z up, mm.

    The walk is that of `devices.people.walkway`, seen from a treadmill: it stays where it is.
    """

    name: str = param("simulated motion capture", help="what the stream is called")
    type: str = param("MoCap", help="its content type")
    source_id: str = param("kinegraph.mocap", help="it stays the same when the outlet is restarted")
    channels: tuple[str, ...] | int = param(LABELS, help="always these: LHIP.x, LHIP.y, ... RTOE.z")
    rate_hz: float = param(100.0, above=0, most=1000, help="frames per second")
    unit: str = param("mm", help="always mm")

    def values(self, signal: Signal, start: int, stop: int) -> NDArray[np.float64]:
        walk = Walkway(seed=self.seed)
        index = np.round(np.arange(start, stop) * (EMG_HZ / self.rate_hz)).astype(np.int64)
        markers = WalkwayTrial(walk).markers(index)
        markers[:, :, 1] -= walk.speed_m_s * 1000 * index[:, None] / EMG_HZ
        return np.asarray(markers.reshape(len(index), -1))
