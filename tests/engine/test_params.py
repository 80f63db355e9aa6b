"""Parameters from YAML: taken as they are, or refused with the name, the value and what would be accepted."""

from __future__ import annotations

import copy
import datetime
import pickle
from dataclasses import dataclass
from typing import Any, Literal

import jsonschema
import numpy as np
import pytest

from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.operators import Lowpass
from kinegraph.stream.api.input import Input
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import MissingParameter, build, check, help_of, param, schema
from kinegraph.stream.source import Source


@dataclass(frozen=True, slots=True)
class Band:
    low_hz: float
    high_hz: float = param(40.0, most=500.0)


@dataclass(frozen=True, slots=True)
class Part:
    port: str = param(help="where it is plugged in")
    cutoff_hz: float = param(20.0, above=0.0, below=500.0, help="half of it is gone here")
    order: int = param(4, least=1, most=8)
    mode: Literal["low", "high"] = param("low")
    reference: Literal["auto"] | float = param("auto")
    limit_s: float | None = param(None, least=0.0)
    loud: bool = param(False)
    channels: tuple[str, ...] = param(())
    widths_s: tuple[float, ...] = param((), above=0.0)
    pairs: tuple[tuple[str, str], ...] = param(())
    gains: dict[str, float] | None = param(None, most=10.0)
    band: Band | None = param(None)
    bands: dict[str, tuple[Band, ...]] | None = param(None)


def made(**values: Any) -> Part:
    return build(Part, {"port": "/dev/x", **values})


@pytest.mark.parametrize(
    ("name", "given", "taken"),
    [
        ("cutoff_hz", 30, 30.0),
        ("cutoff_hz", 1e-9, 1e-9),
        ("order", 8, 8),
        ("mode", "high", "high"),
        ("reference", 2, 2.0),
        ("limit_s", None, None),
        ("limit_s", 0, 0.0),
        ("loud", True, True),
        ("channels", ["a", "b"], ("a", "b")),
        ("widths_s", [1, 0.5], (1.0, 0.5)),
        ("pairs", [["a", "b"], ["c", "d"]], (("a", "b"), ("c", "d"))),
        ("gains", {"a": 10}, {"a": 10.0}),
        ("band", {"low_hz": 1}, Band(1.0)),
    ],
)
def test_what_fits_is_taken(name: str, given: Any, taken: Any) -> None:
    found = getattr(made(**{name: given}), name)
    assert found == taken
    assert type(found) is type(taken)
    jsonschema.validate({"port": "/dev/x", name: given}, schema(Part))


@pytest.mark.parametrize(
    ("name", "given", "complaint"),
    [
        ("cutoff_hz", 0, "cutoff_hz is 0; it must be above 0 and below 500"),
        ("cutoff_hz", 500.0, "cutoff_hz is 500.0; it must be above 0 and below 500"),
        ("cutoff_hz", "20", "cutoff_hz is '20'; it must be a number"),
        ("cutoff_hz", True, "cutoff_hz is True; it must be a number"),
        ("cutoff_hz", None, "cutoff_hz is empty; it must be a number"),
        ("order", 2.0, "order is 2.0; it must be a whole number"),
        ("order", 0, "order is 0; it must be at least 1 and at most 8"),
        ("mode", "mid", "mode is 'mid'; it must be 'low' or 'high'"),
        ("reference", "rest", "reference is 'rest'; it must be 'auto' or a number"),
        ("limit_s", -1, "limit_s is -1; it must be at least 0"),
        ("loud", "yes", "loud is 'yes'; it must be true or false"),
        ("channels", "a", "channels is 'a'; it must be a list"),
        ("channels", ["a", 1], r"channels[1] is 1; it must be a text"),
        ("widths_s", [1, -2], r"widths_s[1] is -2; it must be above 0"),
        ("pairs", [["a", 2]], r"pairs[0][1] is 2; it must be a text"),
        ("gains", {"a": 11}, "gains.a is 11; it must be at most 10"),
        ("band", {"low_hz": "x"}, "band.low_hz is 'x'; it must be a number"),
        (
            "band",
            {"low_hz": 1, "hihg_hz": 2},
            "band.hihg_hz is no parameter; did you mean 'high_hz'?",
        ),
        ("bands", {"a": [{"low_hz": 1}, {"low_hz": 1, "low": 2}]}, "bands.a[1].low is no parameter"),
        ("band", 3, "band is 3; it must be a mapping of names to values"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(name: str, given: Any, complaint: str) -> None:
    with pytest.raises(ParameterError) as caught:
        made(**{name: given})
    assert str(caught.value).startswith(complaint)
    assert caught.value.parameter == name
    with pytest.raises(ParameterError) as again:
        check(Part(**{"port": "/dev/x", name: given}))
    assert str(again.value) == str(caught.value)
    schema_of = schema(Part)
    if given != 2.0:  # JSON has one kind of number: to a schema 2.0 is whole
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({"port": "/dev/x", name: given}, schema_of)


@pytest.mark.parametrize("given", [float("nan"), float("inf"), datetime.date(2026, 1, 1), object(), [float("nan")]])
def test_what_is_no_plain_value_is_refused(given: Any) -> None:
    with pytest.raises(ParameterError, match=r"cutoff_hz is .*; it must be a finite number"):
        made(cutoff_hz=given)


def test_an_unknown_name_comes_with_the_nearest() -> None:
    with pytest.raises(ParameterError, match=r"cutof_hz is no parameter; did you mean 'cutoff_hz'\?"):
        made(cutof_hz=1)


def test_bounds_hold_within_a_mapping_too() -> None:
    with pytest.raises(ParameterError, match=r"band.high_hz is 501; it must be at most 500"):
        made(band={"low_hz": 1, "high_hz": 501})


def test_what_is_missing_is_named() -> None:
    with pytest.raises(MissingParameter, match="port is missing; Part requires it"):
        build(Part, {})


def test_the_schema_tells_bounds_help_and_what_is_required() -> None:
    properties = schema(Part)["properties"]
    assert properties["cutoff_hz"]["exclusiveMinimum"] == 0.0
    assert properties["cutoff_hz"]["exclusiveMaximum"] == 500.0
    assert properties["widths_s"]["items"]["exclusiveMinimum"] == 0.0
    assert properties["port"]["description"] == help_of(Part, "port") == "where it is plugged in"
    assert schema(Part)["required"] == ["port"]


@dataclass(frozen=True, slots=True)
class Gain(Operator[None]):
    factor: float = param(1.0, above=0.0)
    channels: tuple[str, ...] = param(())
    table: Any = None


@dataclass(frozen=True, slots=True)
class Probe(Source):
    rate_hz: float = param(above=0.0)
    band: Band | None = param(None)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Gain(-5), "factor is -5; it must be above 0"),
        (lambda: Gain("abc"), "factor is 'abc'; it must be a number"),  # type: ignore[arg-type]
        (lambda: Gain(channels="abc"), "channels is 'abc'; it must be a list"),  # type: ignore[arg-type]
        (lambda: Gain(float("nan")), "factor is nan; it must be a finite number"),
        (lambda: Probe(0.0), "rate_hz is 0.0; it must be above 0"),
        (lambda: Probe(1.0, Band(1.0, 501.0)), "band.high_hz is 501.0; it must be at most 500"),
        (lambda: Probe(1.0, object()), "band is <object"),  # type: ignore[arg-type]
    ],
)
def test_what_is_given_in_python_is_checked_where_it_is_given(make: Any, complaint: str) -> None:
    with pytest.raises(ParameterError) as caught:
        make()
    assert str(caught.value).startswith(complaint)


def test_what_is_given_in_python_is_kept_as_yaml_would_have_given_it() -> None:
    made = Gain(np.int64(2), ["a", "b"], table := [object()])  # type: ignore[arg-type]
    assert repr(made.factor) == "2.0"
    assert made.channels == ("a", "b")
    assert made.table is table
    assert Probe(3, Band(2)) == build(Probe, {"rate_hz": 3, "band": {"low_hz": 2}})
    assert repr(Probe(3, Band(2))) == repr(build(Probe, {"rate_hz": 3, "band": {"low_hz": 2}}))


def test_what_lacks_within_a_mapping_is_named() -> None:
    with pytest.raises(ParameterError, match=r"band is .*; it must be complete; 'low_hz' is missing"):
        made(band={"high_hz": 3})


def test_a_misspelt_name_in_python_gets_the_hint_that_yaml_gives() -> None:
    for part in (lambda: Lowpass(cutof_hz=6), lambda: Treadmill(duration=1.0)):  # type: ignore[call-arg]
        with pytest.raises(ParameterError, match=r"is no parameter; did you mean '(cutoff_hz|duration_s)'\?"):
            part()
    assert (
        copy.deepcopy(Lowpass(cutoff_hz=6)) == pickle.loads(pickle.dumps(Lowpass(cutoff_hz=6))) == Lowpass(cutoff_hz=6)
    )


@pytest.mark.parametrize(
    ("given", "meant"),
    [("newtons", "N"), ("microvolts", "uV"), ("UV", "uV"), ("m/s^2", "m/s2"), ("milivolts", "mV"), ("degrees", "deg")],
)
def test_a_known_unit_in_another_spelling_is_refused_with_the_known_one(given: str, meant: str) -> None:
    with pytest.raises(ParameterError, match=rf"units\[1\] is .*; did you mean '{meant}'\?"):
        Input(channels=("a", "b"), rate_hz=100.0, units=("V", given))


def test_units_that_are_known_or_unheard_of_are_taken() -> None:
    for unit in ("", "uV", "µV", "g", "spoons", "% MVC", "counts", "px"):
        assert Input(channels=("a",), rate_hz=100.0, units=(unit,)).specs()["out"].units == (unit,)
