"""What a pose network sees of a person, in an image beside the person's depth."""

from kinegraph.operators.body.network.operator import PoseNetwork

__all__ = ["PoseNetwork"]
