"""The bench of depth frames runs, its contenders compute the same, and a night of a few frames goes through the whole graph."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from bench.night import night
from bench.pictures import face, finer, simplified
from bench.sleep import Numpy, OpenCV, blocks_of, learned, movement, numpy_fixed
from kinegraph.devices.people.bedroom import Bedroom
from kinegraph.devices.people.night import made_up, plan
from kinegraph.stream.chunk import Array, Chunk


@pytest.fixture(scope="module")
def seen() -> Array:
    room = Bedroom(640, 480, (plan(made_up(0.2)),))
    return np.stack([room.frame(k, 500 + k / 30) for k in range(4)])


def test_the_contenders_compute_the_same(seen: Array) -> None:
    a, b = seen[0].astype(int), seen[1].astype(int)
    both = (a > 0) & (b > 0)
    expected = np.abs(a - b)[both].mean()
    assert Numpy().change(seen[0], seen[1]) == pytest.approx(expected)
    if find_spec("cv2") is not None:
        assert OpenCV().change(seen[0], seen[1]) == pytest.approx(expected)
    operator, basis = learned(seen, 2)
    ours = operator.process("in", Chunk(np.array([2 * 10**18]), seen[:1], 2 * 10**18))[1][1].data[0]
    assert np.abs(ours.astype(int) - numpy_fixed(seen[0], basis)).max() <= 40, "but for the mean block"
    assert blocks_of(seen[0]).min() > 0


def test_what_is_promised_is_measured(seen: Array) -> None:
    section = movement(seen, 2)
    assert section.goals[0].limit == 0.15 and {"kinegraph", "numpy"} <= {row[0] for row in section.rows}
    assert "2 frames" in night(seen, 2).title


def test_a_block_shows_nothing_of_a_face_but_its_level(seen: Array) -> None:
    relief = face(480, 640, 87, 320)
    with_face = np.where(seen > 0, seen - relief, 0).astype(np.uint16)
    assert finer((simplified(seen, 1) - simplified(with_face, 1)).mean(axis=0)) < 1e-9 * finer(relief)
