"""Ground contact of a mesh (the future work of thesis 9.6): a foot that stands keeps its place, and the mesh goes with it."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

LOW, LIFTED = 0.6, 1.0
"""A foot stands once it is less than the first above the ground, until it is more than the second (shares of its height's spread)."""
RISES_M_S = 0.05
"""The ground is where the lowest foot was of late: it may rise so quickly."""
REACH = 0.45
"""A foot that is held takes along what is within this share of the mesh's height."""
MAX_SHARE = 0.25
"""No foot is held farther from where its markers put it than this share of the mesh's height: it is dragged along."""
EASE_S = 0.1
"""A foot that is lifted goes to where its markers put it this quickly."""
STANDS, WAS, LOCK, AWAY = 0, 1, 4, 6
"""Places in a foot (9,): whether it stands; where it was before the mesh travelled (3,); where it stands (x, z); by how much it is held
away from where its markers put it (3,)."""


def around_feet(rest: Samples, feet: Times) -> Samples:
    """How much each vertex (v, 3) of a mesh at rest goes with each of its `feet` (k,): (v, k); y is up."""
    away = np.linalg.norm(rest[:, None] - rest[feet], axis=2)
    height = float(np.ptp(rest[:, 1]))
    near = np.maximum(1.0 - away / (REACH * height), 0.0) ** 2
    near *= 3.0 - 2.0 * np.sqrt(near)
    others = 1.0 / (away + 1e-3 * height) ** 4
    return np.asarray(near * others / others.sum(axis=1, keepdims=True))


@kernel
def stand_on_ground(
    mesh: Samples, feet: Times, spread: Samples, around: Samples, most: float, dt: float, travelled: Samples, memory: Samples
) -> None:  # fmt: skip
    """Move `mesh` (v, 3) so that feet that are down stand still and on the ground.

    feet    (k,)    vertices; spread (k,) the standard deviation of their heights in the training
    around  (v, k)  how much each vertex goes with each foot       most  the farthest that a foot is held (m)
    travelled (3,)  how far the mesh has gone (x, z), and the height of the ground; memory (k, 9) see STANDS
    """
    count, ways = feet.shape[0], 0
    travelled[2] += RISES_M_S * dt
    for k in range(count):
        travelled[2] = min(travelled[2], mesh[feet[k], 1])
    across = along = 0.0
    for k in range(count):
        foot, at = memory[k], mesh[feet[k]]
        stood = foot[STANDS] > 0.0
        foot[STANDS] = 1.0 if at[1] - travelled[2] < (LIFTED if stood else LOW) * spread[k] else 0.0
        if foot[STANDS] > 0.0 and stood:
            ways += 1
            across += at[0] - foot[WAS]
            along += at[2] - foot[WAS + 2]
        elif foot[STANDS] > 0.0:
            foot[LOCK] = foot[LOCK + 1] = math.nan
        for a in range(3):
            foot[WAS + a] = at[a]
    if ways:
        travelled[0] -= across / ways
        travelled[1] -= along / ways
    ease = math.exp(-dt / EASE_S)
    for k in range(count):
        foot = memory[k]
        x, z = foot[WAS] + travelled[0], foot[WAS + 2] + travelled[1]
        if foot[STANDS] > 0.0:
            if foot[LOCK] != foot[LOCK] or math.hypot(foot[LOCK] - x, foot[LOCK + 1] - z) > most:
                foot[LOCK], foot[LOCK + 1] = x + foot[AWAY], z + foot[AWAY + 2]
            foot[AWAY], foot[AWAY + 2] = foot[LOCK] - x, foot[LOCK + 1] - z
            foot[AWAY + 1] += (1.0 - ease) * (travelled[2] - foot[WAS + 1] - foot[AWAY + 1])
        else:
            for a in range(3):
                foot[AWAY + a] *= ease
    for v in range(mesh.shape[0]):
        mesh[v, 0] += travelled[0]
        mesh[v, 2] += travelled[1]
        for k in range(count):
            for a in range(3):
                mesh[v, a] += around[v, k] * memory[k, AWAY + a]
