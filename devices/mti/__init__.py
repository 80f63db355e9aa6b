"""Xsens/Movella MTi inertial sensors, on a serial port, over TCP or directly on USB."""

from kinegraph.devices.mti.source import Mti

__all__ = ["Mti"]
