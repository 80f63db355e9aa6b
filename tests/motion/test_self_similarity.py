"""Self-similarity across gaps: what was lost is not known, and what was before a long gap is forgotten."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.features.self_similarity import SelfSimilarity
from kinegraph.stream.chunk import Array, Chunk, StreamSpec
from kinegraph.stream.data.rows import taking

PERIOD = 10**7
SPEC = StreamSpec((1,), rate_hz=100.0)


def distances(*pieces: tuple[int, list[float]], **parameters: float) -> Array:
    """Of rows that come in pieces, each with how many are missing before it."""
    operator = SelfSimilarity(**{"every": 1, "lags": 4, **parameters})  # type: ignore[arg-type]
    operator.open({"in": SPEC})
    take, at, made = taking(operator, {"in": SPEC}), 0, []
    for lost, values in pieces:
        time = (at + lost + np.arange(len(values))) * PERIOD
        at += lost + len(values)
        out = operator.process("in", take("in", Chunk(time, np.array(values)[:, None], int(time[-1]), lost)))
        made.append(out.data)  # type: ignore[union-attr]
    return np.concatenate(made)


def test_a_row_is_compared_with_those_before_it() -> None:
    made = distances((0, [1.0, 3.0, 6.0, 10.0, 15.0, 21.0]))
    np.testing.assert_allclose(made[-1], [6.0, 11.0, 15.0, 18.0])
    assert np.isnan(made[0]).all() and made[1, 0] == 2.0 and np.isnan(made[1, 1:]).all()


def test_what_was_lost_is_not_known_and_lags_stay_times() -> None:
    made = distances((0, [1.0, 3.0, 6.0]), (2, [10.0]))
    np.testing.assert_allclose(made[-1], [np.nan, np.nan, 4.0, 7.0])


def test_what_was_before_a_long_gap_is_forgotten_also_behind_a_short_one() -> None:
    made = distances((0, [1.0, 3.0, 6.0, 10.0, 15.0]), (10, [20.0]), (1, [30.0]), reset_gap_s=0.05)
    np.testing.assert_allclose(made[-1], [np.nan, 10.0, np.nan, np.nan])
    assert np.isnan(made[-2]).all()
