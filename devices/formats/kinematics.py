"""From joint angles to joint positions: what BVH and ASF/AMC files need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kinegraph.stream.chunk import Samples

BLOCK = 1 << 14
"""Frames that are worked through together, so that rotations of a long recording are never in memory all at once."""


def blocks(count: int) -> Iterator[slice]:
    """All of `count` frames, some at a time."""
    return (slice(at, min(at + BLOCK, count)) for at in range(0, count, BLOCK))


def about(axis: str, radians: Samples) -> Samples:
    """Rotations (n, 3, 3) about "x", "y" or "z" by angles (n,)."""
    a, b = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    made = np.zeros((len(radians), 3, 3))
    made[:] = np.eye(3)
    made[:, a, a] = made[:, b, b] = np.cos(radians)
    made[:, b, a] = np.sin(radians)
    made[:, a, b] = -made[:, b, a]
    return made


def in_turn(axes: str, degrees: Samples) -> Samples:
    """Rotations (n, 3, 3) that multiply those about each of `axes`, first on the left, by the columns of `degrees` (n, len(axes))."""
    made = np.tile(np.eye(3), (len(degrees), 1, 1))
    for i, axis in enumerate(axes):
        made = np.einsum("nij,njk->nik", made, about(axis, np.radians(degrees[:, i])))
    return made


def place(parents: Sequence[int], steps: Sequence[Samples], turns: Sequence[Samples], *, ends: bool) -> Samples:
    """Joint positions (n, joints, 3) of a tree.

    parents  the number of each joint's parent, lower than its own; -1 for the root
    steps    per joint (n, 3) or (3,): from the parent's place to its own, in the parent's frame; with `ends` in its own frame
    turns    per joint (n, 3, 3): its own frame in its parent's
    """
    n = len(turns[0])
    frames: list[Samples] = []
    made = np.zeros((n, len(parents), 3))
    for j, parent in enumerate(parents):
        before = frames[parent] if parent >= 0 else np.tile(np.eye(3), (n, 1, 1))
        frames.append(np.einsum("nij,njk->nik", before, turns[j]))
        step = np.broadcast_to(steps[j], (n, 3))
        moved = np.einsum("nij,nj->ni", frames[j] if ends and parent >= 0 else before, step)
        made[:, j] = moved + (made[:, parent] if parent >= 0 else 0.0)
    return made
