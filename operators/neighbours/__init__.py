"""Exact nearest neighbours in a sliding window of frames: `Index` for use from Python, `Neighbours` as an operator."""

from kinegraph.operators.neighbours.index import Index
from kinegraph.operators.neighbours.operator import Neighbours

__all__ = ["Index", "Neighbours"]
