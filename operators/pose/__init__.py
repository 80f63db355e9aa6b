"""From markers on a body to the pose of its whole skeleton."""

from kinegraph.operators.pose.operator import WholePose

__all__ = ["WholePose"]
