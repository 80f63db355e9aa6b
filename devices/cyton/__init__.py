"""OpenBCI Cyton, with or without Daisy, through its USB dongle: 8 or 16 channels of EMG and the board's accelerometer."""

from kinegraph.devices.cyton.source import Cyton

__all__ = ["Cyton"]
