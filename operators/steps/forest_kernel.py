"""A random forest as arrays, evaluated as scikit-learn does, bit for bit."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel


@kernel
def forest_probabilities(
    x: Samples,
    roots: Times,
    feature: Times,
    threshold: Samples,
    left: Times,
    right: Times,
    share: Samples,
    out: Samples,
) -> None:
    """The probability of each class (k,) that a forest gives the features `x` (f,): the mean of its trees' leaves.

    roots (t,)               each tree's first node
    feature, threshold, left, right (nodes,)   at a node: left where float32(x[feature]) <= threshold; a leaf's `left` is -1
    share (nodes, k)         of each class among a leaf's training samples
    """
    out[:] = 0.0
    for root in roots:
        node = root
        while left[node] >= 0:
            node = left[node] if np.float32(x[feature[node]]) <= threshold[node] else right[node]
        for c in range(out.shape[0]):
            out[c] += share[node, c]
    for c in range(out.shape[0]):
        out[c] /= roots.shape[0]
