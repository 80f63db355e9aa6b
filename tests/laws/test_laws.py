"""The seven laws of DESIGN, held by every operator of ours, found without a list; see stream/laws for what each rule says.

`KINEGRAPH_EXAMPLES=200 pytest tests/laws/test_laws.py -k Envelope` tries harder.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.laws import Conformance, checks, trials
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet

EXAMPLES = int(os.environ.get("KINEGRAPH_EXAMPLES", "0")) or 2


def _found() -> tuple[dict[str, type[Operator[Any]]], dict[str, str]]:
    """Every operator in `operators`, and those outlets in `devices` that can be tried without a device; and what could not be imported."""
    ours, failed = catalogue(("operators",))
    devices, _ = catalogue(("devices",))
    outlets = {use: part for use, part in devices.items() if issubclass(part, Outlet) and part.cases()}
    return {use: part for use, part in {**ours, **outlets}.items() if issubclass(part, Operator)}, failed


FOUND, FAILED = _found()
each_operator = pytest.mark.parametrize(
    "use", [pytest.param(use, marks=pytest.mark.xdist_group(use), id=use) for use in FOUND]
)
"""An operator's tests run in one process, which makes its cases and loads its kernels once."""


@cache
def _trials(use: str) -> list[Conformance]:
    """An operator on each of its cases, made where they are asked for: some take seconds. One without cases fails."""
    return [make() for make in trials(FOUND[use])]


@contextmanager
def _named(case: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:
        error.add_note(f"on {case}")
        raise


def test_every_module_was_searched() -> None:
    assert not FAILED
    assert FOUND, "there must be operators"


@each_operator
def test_laws_without_chance(use: str) -> None:
    for k, trial in enumerate(_trials(use)):
        with _named(f"case {k}"):
            for check in checks(trial).values():
                check()


@each_operator
def test_laws_by_chance(use: str) -> None:
    for k, trial in enumerate(_trials(use)):
        with _named(f"case {k}"):
            _tried_by_chance(trial)


def _tried_by_chance(trial: Conformance) -> None:
    @settings(max_examples=EXAMPLES, database=None)
    @given(data=st.data())
    def attempt(data: st.DataObject) -> None:
        trial.attempt(lambda least, most: data.draw(st.integers(least, most)))

    attempt()
