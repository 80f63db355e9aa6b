"""Which markers can be where they are said to be, by the lengths of bones."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.body.bones import BONES, possible
from kinegraph.operators.body.names import MARKERS
from kinegraph.stream.chunk import Samples

DOWN = {
    "shoulder": 1.45,
    "elbow": 1.15,
    "wrist": 0.88,
    "hip": 0.95,
    "knee": 0.54,
    "ankle": 0.12,
    "heel": 0.05,
    "toe": 0.03,
}


def standing(size: float) -> Samples:
    """Markers (20, 3) of somebody `size` times 1.75 m tall who lets the arms hang."""
    made = np.zeros((len(MARKERS), 3))
    for i, name in enumerate(MARKERS):
        side, _, joint = name.partition("_")
        made[i] = ({"left": 0.2, "right": -0.2}.get(side, 0.0), size * DOWN.get(joint, 1.65), 0.0)
    return made


@pytest.mark.parametrize("size", [0.7, 1.0, 1.1])
def test_a_body_of_any_size_is_possible(size: float) -> None:
    assert possible(size, standing(size)).all()


@pytest.mark.parametrize("bone", [bone for bone in BONES if bone[:2] != ("shoulder", "wrist")])
@pytest.mark.parametrize(("share", "can"), [(0.55, False), (0.65, True), (1.35, True), (1.45, False)])
def test_a_bone_is_at_most_two_fifths_off(
    bone: tuple[str, str, float, tuple[str, ...]], share: float, can: bool
) -> None:
    joint, other, long, doubtful = bone
    markers = standing(1.0)
    a, b = MARKERS.index(f"left_{joint}"), MARKERS.index(f"left_{other}")
    markers[b] = markers[a] + (share * long, 0.0, 0.0)
    found = possible(1.0, markers)
    assert found[b] == can
    if not can:
        assert not found[[MARKERS.index(f"left_{name}") for name in doubtful]].any()
    assert found[[i for i, name in enumerate(MARKERS) if name.startswith("right_")]].all()


def test_a_hand_whose_elbow_is_not_seen_is_nobodys() -> None:
    markers = standing(1.0)
    markers[MARKERS.index("left_elbow")] = np.nan
    found = possible(1.0, markers)
    assert not found[MARKERS.index("left_wrist")] and found[MARKERS.index("right_wrist")]
