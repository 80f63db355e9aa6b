"""Channels chosen, named and computed from one another."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.filters.arithmetic import Arithmetic
from kinegraph.operators.filters.channels import Select
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.params import build
from tests.support.one_stream import noise, run, same

SPEC = StreamSpec((3,), rate_hz=200.0, channels=("x", "y", "z"), units=("g", "g", "deg"))


def test_channels_are_chosen_in_order_and_renamed():
    data = noise()
    data[4, 2] = np.inf
    spec, _, out, _ = run(Select(channels=("z", "x"), rename={"x": "along"}), data, spec=SPEC, cuts=(1, 5))
    assert spec.channels == ("z", "along") and spec.units == ("deg", "g") and spec.shape == (2,)
    assert same(out, data[:, [2, 0]])


def test_channels_without_names_go_by_number():
    spec, _, out, _ = run(Select(channels=(2, "0")), noise(), spec=StreamSpec((3,), rate_hz=200.0))
    assert spec.channels == ("2", "0") and same(out, noise()[:, [2, 0]])


def test_points_are_channels_and_the_dtype_stays():
    data = np.random.default_rng(0).normal(size=(50, 3, 3)).astype(np.float32)
    points = StreamSpec((3, 3), np.dtype(np.float32), 100.0, channels=("hip", "knee", "toe"), units=("m",))
    spec, _, out, _ = run(Select(channels=("toe",)), data, spec=points)
    assert spec.shape == (1, 3) and out.dtype == np.float32 and same(out, data[:, 2:])


@pytest.mark.parametrize(
    ("operator", "message"),
    [
        (Select(channels=("zz",)), r"channels is 'zz'; it must be a channel of the input; did you mean 'z'\?"),
        (Select(channels=(3,)), r"channels is 3; it must be a channel's name, or a number from 0 to 2"),
        (Select(channels=("x", 0)), r"it must be a list that names no channel twice"),
        (Select(rename={"u": "v"}), r"there is no 'u'"),
        (Select(rename={"x": "y"}), r"names that differ; 'y' would be there twice"),
        (Arithmetic({"a": ("summ", "x", "y")}), r"compute\.a is 'summ'; .*did you mean 'sum'\?"),
        (Arithmetic({"a": ("sum", "x", "w")}), r"compute\.a is 'w'; it must be a channel of the input"),
        (Arithmetic({"a": ("sum", "x", "z")}), r"channels of one unit, not g, deg"),
        (Arithmetic({"a": ("difference", "x")}), r"two channels, as a difference is of two"),
        (
            Arithmetic({"x": ("sum", "x", "y")}, keep=True),
            r"compute is 'x'; it must be a name that no kept channel has",
        ),
        (Arithmetic({}), r"at least one new channel"),
    ],
)
def test_what_cannot_be_chosen_or_computed_is_refused(operator, message):
    with pytest.raises(ParameterError, match=message):
        operator.open({"in": SPEC})


def test_arithmetic_is_for_signals():
    with pytest.raises(InputError, match="must be a signal of channels"):
        Arithmetic({"a": ("sum", "0")}).open({"in": StreamSpec((4, 3), rate_hz=1.0)})


def test_channels_are_computed_from_one_another():
    data = noise()
    x, y, z = data.T
    operator = build(
        Arithmetic,
        {
            "compute": {
                "total": ["sum", "x", "y"],
                "left less right": ["difference", "x", "y"],
                "middle": ["mean", "x", "y"],
                "length": ["magnitude", "x", "y"],
                "area": ["product", "x", "z"],
                "share": ["ratio", "x", "y"],
                "slope": ["ratio", "x", "z"],
                "low": ["min", "x", "y"],
                "high": ["max", "y", "x"],
            },
            "keep": True,
        },
    )
    spec, _, out, _ = run(operator, data, spec=SPEC, cuts=(1, 100))
    assert spec.channels[:5] == ("x", "y", "z", "total", "left less right")
    assert spec.units == ("g", "g", "deg", "g", "g", "g", "g", "g deg", "", "g/deg", "g", "g")
    made = [x, y, z, x + y, x - y, (x + y) / 2, np.sqrt(x * x + y * y), x * z, x / y, x / z]
    assert same(out, np.stack([*made, np.minimum(x, y), np.maximum(x, y)], axis=1))


def test_what_is_not_defined_is_nan():
    data = np.array([[1.0, 0.0, 0.0], [np.nan, 1.0, 0.0], [1.0, np.inf, 0.0]])
    every = {name: (name, "x", "y") for name in ("sum", "ratio", "min", "max", "magnitude")}
    _, _, out, _ = run(Arithmetic(every), data, spec=SPEC)
    assert np.isnan(out).tolist() == [[False, True, False, False, False], [True] * 5, [True] * 5]
