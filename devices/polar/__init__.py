"""The Polar H10 over Bluetooth LE: electrocardiogram and acceleration, on the belt's own clock."""

from kinegraph.devices.polar.source import Polar

__all__ = ["Polar"]
