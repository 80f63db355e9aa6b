"""Movella (Xsens) DOT over Bluetooth LE: orientation, acceleration, angular velocity, on the sensor's own clock."""

from kinegraph.devices.dot.source import MovellaDot

__all__ = ["MovellaDot"]
