"""The Lab Streaming Layer: streams of other programs come in by `LslInlet`."""

from devices.lsl.inlet import LslInlet

__all__ = ["LslInlet"]
