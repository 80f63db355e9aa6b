"""Online segmentation: which stretch of motion is one action, where each repetition starts, which are alike (thesis, chapter 2)."""

from kinegraph.operators.segmentation.operator import Segment

__all__ = ["Segment"]
