"""Delsys Trigno through its SDK server (or Trigno Control Utility) over TCP: EMG of up to 16 sensors and their auxiliary channels."""

from kinegraph.devices.trigno.source import Trigno

__all__ = ["Trigno"]
