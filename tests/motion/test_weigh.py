"""Features of several sensors in one distance, each sensor by its weight."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.features.weigh import Weigh
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid

SPEC = StreamSpec((5,), rate_hz=30.0, channels=("TA", "SO", "GM", "TA.ax", "TA.ay"), units=("uV",) * 3 + ("g",) * 2)


def test_a_sensor_counts_by_its_weight_however_many_channels_it_has() -> None:
    weights = {"[A-Z][A-Z]": 1.0, "*.a?": 2.0}
    operator = Weigh(weights=weights)
    spec = operator.open({"in": SPEC})["out"]
    assert spec.meta["weights"] == weights and set(spec.units) == {""}
    x = np.random.default_rng(0).normal(size=(2, 5))
    x[0, 1] = np.nan
    made = operator.process("in", Chunk(grid(30.0, 2), x, int(grid(30.0, 2)[-1])))
    (out,) = [made] if isinstance(made, Chunk) else [chunk for _, chunk in made or []]
    assert np.isnan(out.data[0, 1]) and np.isfinite(np.delete(out.data[0], 1)).all()
    squares = out.data[1] ** 2
    expected = (1.0 * (x[1, :3] ** 2).mean() + 2.0 * (x[1, 3:] ** 2).mean()) / 3.0
    assert squares.mean() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"*.a?": 1.0}, "TA matches; no channels do"),
        ({"*": 1.0, "TA": 1.0}, "TA matches; 2 do"),
        ({"*": 1.0, "wrist": 1.0}, "what matches one of TA"),
        ({"*": 0.0}, "a number above 0"),
        ({}, "a number above 0"),
    ],
)
def test_weights_that_leave_out_a_channel_or_name_none_are_refused(weights: dict[str, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Weigh(weights=weights).open({"in": SPEC})
