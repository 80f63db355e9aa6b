"""Qualisys Track Manager, live by its real-time protocol: labelled markers, rigid bodies, segments of skeletons, analog channels."""

from kinegraph.devices.qualisys.source import Qualisys

__all__ = ["Qualisys"]
