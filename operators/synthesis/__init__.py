"""New motion in real time: walked on a motion graph, and by motion matching (thesis, chapter 10)."""

from kinegraph.operators.synthesis.source import Synthesis

__all__ = ["Synthesis"]
