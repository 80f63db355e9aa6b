"""What comes back is of the kind that it was: by the neighbours of its frames, over the whole session."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.emg_session import drive
from kinegraph.operators.neighbours.returning import KNOWN, Returning
from kinegraph.stream.chunk import NS, Array, StreamSpec, grid
from kinegraph.stream.errors import InputError

RATE, TURN = 30.0, 40
EVENT = np.dtype([("onset", "<i8"), ("end", "<i8"), ("repetition", "<i4"), ("cluster", "<i8")])


def loop(kind: int) -> Array:
    turn = 2 * np.pi * np.arange(TURN) / TURN
    return np.stack([np.cos(turn) + 8.0 * kind, np.sin(turn), np.cos((kind + 1) * turn)], 1)


def session(kinds: list[int], clusters: list[int], **how: Any) -> Array:
    """What each of these repetitions is; a segmentation called them so."""
    rng = np.random.default_rng(1)
    frames = np.concatenate([loop(kind) for kind in kinds]) + rng.normal(0.0, 0.02, (TURN * len(kinds), 3))
    stamps = grid(RATE, len(frames))
    rows = [(stamps[TURN * k], stamps[TURN * k + TURN - 1], 1, cluster) for k, cluster in enumerate(clusters)]
    found = np.array(rows, EVENT)
    given = {
        "in": (StreamSpec((3,), rate_hz=RATE), stamps, frames),
        "primitive": (StreamSpec((), EVENT), found["end"] + NS // 3, found),
    }
    return np.asarray(drive(Returning(within=0.3, **how), given)["known"][2])


def test_an_activity_that_returns_under_a_new_cluster_is_known_again() -> None:
    made = session([0, 0, 1, 1, 2, 2, 0, 0, 1], [0, 0, 1, 1, 2, 2, 3, 3, 4])
    assert made.dtype == KNOWN
    assert made["known"].tolist() == [0, 0, 1, 1, 2, 2, 0, 0, 1]
    assert made["returned"].tolist() == [False] * 6 + [True, False, True]
    assert made["away_s"][6] == pytest.approx((4 * TURN + 1) / RATE, abs=1e-6)


def test_what_left_the_window_is_forgotten() -> None:
    kinds, clusters = [0, 1, 1, 1, 1, 0], [0, 1, 1, 1, 1, 2]
    assert session(kinds, clusters)["returned"][-1]
    assert not session(kinds, clusters, window_s=3 * TURN / RATE)["returned"][-1]


def test_a_cluster_is_of_one_kind_whatever_its_later_repetitions_look_like() -> None:
    assert session([0, 1, 0], [0, 0, 0])["known"].tolist() == [0, 0, 0]


def test_stretches_that_do_not_repeat_are_no_kind() -> None:
    spec = StreamSpec((3,), rate_hz=RATE)
    rows = np.array([(0, NS, 0, -1), (NS, 2 * NS, 1, -1)], EVENT)
    stamps = grid(RATE, 90)
    given = {"in": (spec, stamps, np.zeros((90, 3))), "primitive": (StreamSpec((), EVENT), rows["end"] + 1, rows)}
    assert len(drive(Returning(within=1.0), given)["known"][2]) == 0


def test_it_needs_a_radius() -> None:
    with pytest.raises(InputError, match="radius"):
        Returning().open({"in": StreamSpec((3,), rate_hz=RATE), "primitive": StreamSpec((), EVENT)})
