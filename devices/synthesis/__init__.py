"""New motion, walked on a motion graph in real time (thesis, chapter 10)."""

from kinegraph.devices.synthesis.source import Synthesis

__all__ = ["Synthesis"]
