"""Which of a test's parameters run when."""

from __future__ import annotations

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
