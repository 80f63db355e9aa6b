"""One near-rigid part of a mesh, as it was learned."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kinegraph.operators.steering.model.marker_frame import MarkerFrame
from kinegraph.operators.steering.model.regression import Learned
from kinegraph.stream.chunk import Samples, Times


@dataclass(frozen=True, slots=True)
class Part:
    """A near-rigid part: its vertices, their weights, mean shape about its centre (n, 3), modes (k, 3 n), size; and its regression.

    features  the features that it follows
    parent    the part that carries it; -1 if it is placed by itself
    above, own (1 + k, 3)  the virtual joint in the parent's frame and in its own, and how each mode moves it; (0, 3) without a parent
    frame     what the part moves with, and sees its markers from, where its place is not learned
    """

    vertices: Times
    weights: Samples
    mean: Samples
    modes: Samples
    size: float
    features: Times
    learned: Learned
    parent: int = -1
    above: Samples = field(default_factory=lambda: np.zeros((0, 3)))
    own: Samples = field(default_factory=lambda: np.zeros((0, 3)))
    frame: MarkerFrame | None = None
