"""Every operator's docstring has an example: numbers in and the numbers that come out."""

from __future__ import annotations

import doctest
import io
import sys
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from kinegraph.stream.data.arrays import series
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.laws.examples import apply, events, tried
from kinegraph.stream.operator import Operator

OPERATORS = {use: part for use, part in catalogue(("operators",))[0].items() if issubclass(part, Operator)}
NAMES = {"np": np, "series": series, "apply": apply, "events": events, "tried": tried}
"""What an example may use beside the names of its module."""


@pytest.mark.parametrize("kind", [pytest.param(kind, id=use) for use, kind in OPERATORS.items()])
def test_the_example_in_an_operators_docstring_is_right(kind: Any) -> None:
    names = {**vars(sys.modules[kind.__module__]), **NAMES}
    test = doctest.DocTestParser().get_doctest(kind.__doc__, names, kind.__name__, None, 0)
    assert test.examples, "an operator needs an example: numbers in, numbers out (kinegraph.stream.laws.examples)"
    wrong = io.StringIO()
    with capture_logs():
        doctest.DocTestRunner().run(test, out=wrong.write)
    assert not wrong.getvalue(), wrong.getvalue()
