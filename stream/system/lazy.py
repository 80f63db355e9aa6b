"""Names that a module offers without importing what they come from until they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def offered(module: str, where: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a module that offers names from others.

    where   {"Lowpass": "operators.filters.iir"}, or, where it is called otherwise there, {"Graph": "stream.api.builder:GraphBuilder"}
    """

    def get(name: str) -> Any:
        if name in where:
            found, _, theirs = where[name].partition(":")
            return getattr(import_module(found), theirs or name)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return get, lambda: sorted(where)
