"""Any device that sends binary frames of fixed length, declared in the graph: sync bytes, fields, checksum, counter, time."""

from kinegraph.devices.frames.source import Binary

__all__ = ["Binary"]
