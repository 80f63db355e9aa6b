"""Exemplars: how many are kept, and which make room."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.kernels.clusters import keep
from kinegraph.operators.segmentation.kernels.distances import insert
from kinegraph.operators.segmentation.kernels.layout import MAX_CLUSTERS, Memory, allocate
from tests.motion.segmentation_runs import QUICK, played
from tests.motion.test_segmentation_kernels import FRAMES


def exercise(kind: int, length: int, times: int = 1, width: int = 4) -> Any:
    turn = np.arange(times * length) * 2 * np.pi / length
    mix = np.random.default_rng(kind).normal(size=(4, width))
    return np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix


def seen(made: Memory, x: Any) -> int:
    """Frames x (n, features) come; the number of the next one."""
    for row in x:
        number = insert(made, row, 0)
    return int(number) + 1


def living(s: Memory) -> list[int]:
    return [k for k in range(MAX_CLUSTERS) if s.cluster_numbers[k] >= 0]


def test_those_used_longest_ago_make_room_and_what_the_others_hold_does_not_change() -> None:
    made = allocate(4, FRAMES, 0.1, 0.5).with_room(64)
    held: dict[int, Any] = {}
    for kind, length in enumerate(np.random.default_rng(1).integers(5, 30, 3 * MAX_CLUSTERS)):
        x = exercise(kind, int(length))
        end = seen(made, x)
        held[keep(made, end - len(x), len(x))] = x
        for k in living(made):
            assert np.array_equal(made.exemplars[k, :, : made.exemplar_sizes[k]], held[k].T)
    assert sorted(made.cluster_numbers) == list(range(2 * MAX_CLUSTERS, 3 * MAX_CLUSTERS))


def test_an_exercise_is_known_again_after_thirty_others() -> None:
    kinds = [*range(31), 0]
    places = np.random.default_rng(1).normal(size=(31, 16)) * 3.0
    x = np.concatenate([exercise(kind, 20 + kind % 5, 5, 16) + places[kind] for kind in kinds])
    events, _ = played(Segment(**QUICK), x + 0.02 * np.random.default_rng(0).normal(size=x.shape))
    assert events["activity"]["cluster"][events["activity"]["repeats"]].tolist() == kinds
