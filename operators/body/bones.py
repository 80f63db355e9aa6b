"""Checks by the lengths of the bones which markers of a body can be right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.body.names import MARKERS
from kinegraph.stream.chunk import Samples

BONES = (
    ("shoulder", "elbow", 0.30, ("elbow", "wrist")), ("shoulder", "wrist", 0.50, ("wrist",)), ("elbow", "wrist", 0.27, ("wrist",)),
    ("hip", "knee", 0.41, ("knee", "ankle", "toe")), ("knee", "ankle", 0.42, ("ankle", "toe")),
)  # fmt: skip
"""From joint to joint, how far apart they are (m, for 1.75 m; of shoulder and wrist: at most), and what is doubtful where they are not."""
SHARE = 0.4


def possible(size: float, markers: Samples) -> NDArray[np.bool_]:
    """For each of `markers` (20, 3) m whether it can be there, in a body `size` times 1.75 m tall, by the bone that it ends.

    Where the joint before is not seen it counts as impossible: a hand without an elbow may be anybody's.
    """
    can: NDArray[np.bool_] = np.array(np.isfinite(markers).all(axis=1))
    for side in ("left", "right"):
        for joint, other, long, doubtful in BONES:
            a, b = MARKERS.index(f"{side}_{joint}"), MARKERS.index(f"{side}_{other}")
            apart = float(np.linalg.norm(markers[a] - markers[b])) / (size * long)
            least = 0.0 if (joint, other) == ("shoulder", "wrist") else 1.0 - SHARE
            if not least < apart < 1.0 + SHARE:
                can[[MARKERS.index(f"{side}_{name}") for name in doubtful]] = False
    return can
