"""Which of a test's parameters run when."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def rest_nightly(*values: Any) -> list[Any]:
    """Parameters of which the first guards every change; the others run nightly.

    >>> rest_nightly(1, 2)[0]
    1
    """
    first, *rest = values
    more = [pytest.param(*value if isinstance(value, tuple) else (value,), marks=pytest.mark.nightly) for value in rest]
    return [first, *more]


def one_in_five(values: Iterable[Any]) -> list[Any]:
    """Parameters of which every fifth guards every change; the others run nightly.

    >>> one_in_five("abcdefg")[5]
    'f'
    """
    return [
        value if number % 5 == 0 else pytest.param(value, marks=pytest.mark.nightly)
        for number, value in enumerate(values)
    ]
