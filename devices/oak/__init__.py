"""Depth cameras of Luxonis (OAK), through their library depthai, version 3 (the extra `oak`)."""

from kinegraph.devices.oak.source import Oak

__all__ = ["Oak"]
