"""The Lab Streaming Layer: streams of other programs come in by `LslInlet`, and ours go out by `LslOutlet`."""

from devices.lsl.inlet import LslInlet
from devices.lsl.outlet import LslOutlet

__all__ = ["LslInlet", "LslOutlet"]
