"""Stacks against plain slices, whole and cut, with a gap."""

import numpy as np
import pytest

from kinegraph.operators.features.stack import Stack
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid

pytestmark = pytest.mark.quick


def run(operator, data, times, cuts, lost=None):
    spec = StreamSpec(data.shape[1:], rate_hz=30.0, channels=("a", "b"), units=("cm",))
    made = operator.open({"in": spec})["out"]
    pieces = []
    for start, stop in zip([0, *cuts], [*cuts, len(data)], strict=True):
        until = FOREVER if stop == len(data) else int(times[stop - 1])
        chunk = Chunk(times[start:stop], data[start:stop], until, (lost or {}).get(start, 0))
        pieces += [piece for _, piece in operator.process("in", chunk)]
    return made, pieces


def test_frames_stand_side_by_side_under_the_stamp_of_offset_0():
    data, times = np.random.default_rng(0).normal(size=(100, 2)), grid(30.0, 100)
    spec, pieces = run(Stack(offsets=(5, -10, 0)), data, times, [3, 40, 41])
    made = np.concatenate([piece.data for piece in pieces])
    assert np.array_equal(made, np.hstack([data[0:85], data[10:95], data[15:100]]))
    assert np.array_equal(np.concatenate([piece.time for piece in pieces]), times[10:95])
    assert spec.channels == ("a[-10]", "b[-10]", "a[+0]", "b[+0]", "a[+5]", "b[+5]")
    assert spec.meta["stack"] == {"offsets": [-10, 0, 5], "features": 2}


def test_causal_stacks_are_the_same_numbers_under_the_newest_stamp():
    data, times = np.random.default_rng(0).normal(size=(60, 2)), grid(30.0, 60)
    operator = Stack(offsets=(-4, 0, 4), causal=True)
    _, pieces = run(operator, data, times, [20])
    assert operator.delay_s == 0.0
    assert np.array_equal(pieces[-1].data[-1], np.concatenate([data[51], data[55], data[59]]))
    assert pieces[-1].time[-1] == times[-1]


def test_no_stack_reaches_across_a_long_gap_and_the_loss_stands_where_frames_are_missing():
    data, times = np.random.default_rng(0).normal(size=(80, 2)), grid(30.0, 80)
    times[50:] += 2_000_000_000
    _, pieces = run(Stack(offsets=(-3, 0, 3)), data, times, [50], {50: 60})
    made = [piece for piece in pieces if len(piece)]
    assert [piece.lost for piece in made] == [0, -1]
    assert made[0].time[-1] == times[46] and made[1].time[0] == times[53]
    times[50:] -= 1_900_000_000
    _, pieces = run(Stack(offsets=(-3, 0, 3)), data, times, [50], {50: 3})
    made = [piece for piece in pieces if len(piece)]
    assert [piece.lost for piece in made if piece.lost] == [3]
    assert next(piece for piece in made if piece.lost).time[0] == times[50]
    assert sum(map(len, made)) == 74


@pytest.mark.parametrize("offsets", [(), (1, 1), (-5, -2)])
def test_offsets_that_cannot_be_are_refused(offsets):
    with pytest.raises(ParameterError, match="offsets"):
        Stack(offsets=offsets).open({"in": StreamSpec((2,), rate_hz=30.0)})
