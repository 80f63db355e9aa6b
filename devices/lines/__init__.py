"""Lines of numbers over a serial port or TCP: an Arduino with MyoWare sensors, or anything that prints comma-separated values."""

from kinegraph.devices.lines.source import AsciiLines

__all__ = ["AsciiLines"]
