"""Treadmills over Bluetooth LE (fitness machine service): what the belt does, as a stream; and, if asked, set from a graph."""

from kinegraph.devices.fitness_treadmill.source import FtmsTreadmill

__all__ = ["FtmsTreadmill"]
