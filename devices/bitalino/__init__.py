"""BITalino (r)evolution over Bluetooth's serial port, USB or TCP: one to six analogue inputs, and the digital ones."""

from kinegraph.devices.bitalino.source import Bitalino

__all__ = ["Bitalino"]
