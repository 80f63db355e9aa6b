"""Exemplars: which of them can match at all; how many are kept, and which make room."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.kernels.clusters import can_match, fit, keep, recognise
from kinegraph.operators.segmentation.kernels.distances import insert
from kinegraph.operators.segmentation.kernels.layout import MOST_CLUSTERS, Memory, allocate
from tests.motion.segmentation_runs import QUICK, played
from tests.motion.test_segmentation_kernels import FRAMES
from tests.support.tiers import rest_nightly


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
    return [k for k in range(MOST_CLUSTERS) if s.cluster_numbers[k] >= 0]


def fitting(s: Memory, first: int, last: int, length: int) -> tuple[int, int]:
    """`recognise` in plain words: every exemplar of about this length is warped."""
    best, found, met = s.radius, -1, first
    for slot in living(s):
        size = s.exemplar_sizes[slot]
        if size * 3 <= length * 4 and length * 3 <= size * 4:
            mean, start = fit(s, slot, first, last, False)
            if mean < best:
                best, found, met = mean, slot, start
    return found, met


def holed(x: Any, kind: str) -> Any:
    rng = np.random.default_rng(4)
    if kind == "values":
        return np.where(rng.random(x.shape) < 0.05, np.nan, x)
    if kind == "a feature":
        return np.concatenate([x[:, :3], np.full((len(x), 1), np.nan)], 1)
    return {"far from zero": x + 1e6, "beyond float32": x * 1e30, "tiny": x * 1e-25}.get(kind, x)


@pytest.mark.parametrize("radius", rest_nightly(1.0, 0.05, 0.3))
@pytest.mark.parametrize("kind", ["as it is", "values", "a feature", "far from zero", "beyond float32", "tiny"])
def test_what_is_left_out_would_not_have_matched(kind: str, radius: float) -> None:
    rng = np.random.default_rng(2)
    made = allocate(4, FRAMES, radius * {"beyond float32": 1e30, "tiny": 1e-25}.get(kind, 1.0), 0.5).with_room(64)
    met = []
    for i in range(120):
        number, length = int(rng.integers(0, 60)), int(rng.integers(12, 30))
        end = seen(made, holed(exercise(number, length, 2) + 0.1 * rng.normal(size=(2 * length, 4)), kind))
        first, last = end - 2 * length, end - 1
        found = recognise(made, first, last, length)
        assert found == fitting(made, first, last, length)
        left = [slot for slot in living(made) if not can_match(made, slot, first, last)]
        assert all(fit(made, slot, first, last, False)[0] > made.radius for slot in left)
        met.append(found[0] >= 0)
        if found[0] < 0:
            keep(made, first, length)
        else:
            made.exemplar_uses[found[0]] = made.exemplar_uses.max() + 1
        if i == 60:
            made.cluster_numbers[rng.integers(0, MOST_CLUSTERS, 9)] = -1
    assert radius < 1.0 or any(met)


def test_few_exemplars_are_warped_where_few_can_match() -> None:
    made = allocate(4, FRAMES, 0.1, 0.5).with_room(64)
    for kind in range(MOST_CLUSTERS):
        end = seen(made, exercise(kind, 15))
        keep(made, end - 15, 15)
    end = seen(made, exercise(7, 15, 2))
    may = [can_match(made, slot, end - 30, end - 1) for slot in range(MOST_CLUSTERS)]
    assert may[7] and sum(may) <= 10


def test_those_used_longest_ago_make_room_and_what_the_others_hold_does_not_change() -> None:
    made = allocate(4, FRAMES, 0.1, 0.5).with_room(64)
    held: dict[int, Any] = {}
    for kind, length in enumerate(np.random.default_rng(1).integers(5, 30, 3 * MOST_CLUSTERS)):
        x = exercise(kind, int(length))
        end = seen(made, x)
        held[keep(made, end - len(x), len(x))] = x
        for k in living(made):
            assert np.array_equal(made.exemplars[k, :, : made.exemplar_sizes[k]], held[k].T)
    assert sorted(made.cluster_numbers) == list(range(2 * MOST_CLUSTERS, 3 * MOST_CLUSTERS))


def test_an_exercise_is_known_again_after_thirty_others() -> None:
    kinds = [*range(31), 0]
    places = np.random.default_rng(1).normal(size=(31, 16)) * 3.0
    x = np.concatenate([exercise(kind, 20 + kind % 5, 5, 16) + places[kind] for kind in kinds])
    events, _ = played(Segment(**QUICK), x + 0.02 * np.random.default_rng(0).normal(size=x.shape))
    assert events["activity"]["cluster"][events["activity"]["repeats"]].tolist() == kinds
