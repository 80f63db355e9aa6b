"""The OpenBCI Ganglion over Bluetooth LE: four channels, and its accelerometer."""

from kinegraph.devices.ganglion.source import Ganglion

__all__ = ["Ganglion"]
