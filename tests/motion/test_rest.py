"""What passes where there is rest, and what the gap says."""

import numpy as np

from kinegraph.operators.features.rest import SkipRest
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import grid

RATE = 50.0


def passed(x, cuts=(), **parameters):
    operator, time = SkipRest(moves=0.3, **parameters), grid(RATE, len(x), 0)
    operator.open({"in": StreamSpec((x.shape[1],), rate_hz=RATE, units=("m/s2",))})
    made = []
    for first, last in zip([0, *cuts], [*cuts, len(x)], strict=True):
        made += [
            chunk for _, chunk in operator.process("in", Chunk(time[first:last], x[first:last], int(time[last - 1])))
        ]
    rows = np.concatenate([np.round(chunk.time * RATE / 1e9).astype(int) for chunk in made])
    return rows, [(round(int(chunk.time[0]) * RATE / 1e9), chunk.lost) for chunk in made if chunk.lost]


def test_rest_is_left_out_and_counted():
    x = np.zeros((1000, 2))
    x[300:400, 1] = np.sin(np.arange(100) * 0.5)
    x[:, 0] = 0.1 * np.sin(np.arange(1000))  # trembling
    rows, gaps = passed(x, window_s=2.0)
    began = int(np.flatnonzero(np.abs(x[:, 1]) > 0.3)[0])
    assert rows.tolist() == [*range(99), *range(began, int(rows[-1]) + 1)]
    assert gaps == [(began, began - 99)] and 495 <= rows[-1] <= 500
    again, same = passed(x, cuts=(50, 120, 302, 303, 420, 900))
    assert np.array_equal(again, rows) and same == gaps


def test_slow_movement_passes_and_a_drift_slower_than_that_is_rest():
    turn = np.arange(1500) * 2 * np.pi / (4.0 * RATE)
    rows, gaps = passed(np.sin(turn)[:, None])
    assert len(rows) == 1500 and not gaps
    rows, _ = passed(0.001 * np.arange(1500)[:, None])
    assert len(rows) == 99
