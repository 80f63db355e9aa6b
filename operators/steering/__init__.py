"""Meshes that follow a few markers (thesis, chapter 9)."""

from kinegraph.operators.steering.operator import SteerMesh

__all__ = ["SteerMesh"]
