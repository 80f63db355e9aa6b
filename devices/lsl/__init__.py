"""The Lab Streaming Layer: streams of other programs come in by `LslInlet`, streams of a graph go out by `LslOutlet`."""

from kinegraph.devices.lsl.inlet import LslInlet
from kinegraph.devices.lsl.outlet import LslOutlet

__all__ = ["LslInlet", "LslOutlet"]
