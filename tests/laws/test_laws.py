"""The seven laws of DESIGN, held by every operator of ours, found without a list; see stream/conformance for what each rule says.

`KINEGRAPH_EXAMPLES=200 pytest tests/laws/test_laws.py -k Envelope` tries harder.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.conformance import Broken, Conformance, checks, trials
from stream.graph.parts import catalogue
from stream.operator import Operator
from stream.outlet import Outlet

EXAMPLES = int(os.environ.get("KINEGRAPH_EXAMPLES", "0")) or 12


def _found() -> tuple[dict[str, type[Operator[Any]]], dict[str, str]]:
    """Every operator in `operators`, and those outlets in `devices` that can be tried without a device; and what could not be imported."""
    ours, failed = catalogue(("operators",))
    devices, _ = catalogue(("devices",))
    outlets = {use: part for use, part in devices.items() if issubclass(part, Outlet) and part.cases()}
    return {use: part for use, part in {**ours, **outlets}.items() if issubclass(part, Operator)}, failed


FOUND, FAILED = _found()


@cache
def _makers(use: str) -> list[Callable[[], Conformance]]:
    return trials(FOUND[use])


def _cases() -> list[tuple[str, int]]:
    """(operator, case); one without cases has case -1, which fails."""
    pairs = []
    for use in FOUND:
        try:
            pairs += [(use, k) for k in range(len(_makers(use)))]
        except Broken:
            pairs.append((use, -1))
    return pairs


CASES = _cases()
each_case = pytest.mark.parametrize(("use", "k"), CASES, ids=[f"{use}-{k}" for use, k in CASES])


@cache
def _trial(use: str, k: int) -> Conformance:
    return _makers(use)[k]()


def test_every_module_was_searched() -> None:
    assert not FAILED
    assert FOUND, "there must be operators"


@each_case
def test_laws_without_chance(use: str, k: int) -> None:
    for check in checks(_trial(use, k)).values():
        check()


@each_case
def test_laws_by_chance(use: str, k: int) -> None:
    trial = _trial(use, k)

    @settings(max_examples=EXAMPLES, database=None)
    @given(data=st.data())
    def attempt(data: st.DataObject) -> None:
        trial.attempt(lambda least, most: data.draw(st.integers(least, most)))

    attempt()
