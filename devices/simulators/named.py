"""The simulators by name: one per file of this folder (`cyton`), or anyone's by its dotted path (`my_lab.board.Board`)."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from dataclasses import is_dataclass

from devices import simulators
from devices.simulators.serve import Simulator
from stream.errors import KinegraphError, explain, nearest


def named() -> dict[str, type[Simulator]]:
    """Every simulator of this package, by the name of its file (by its class's name too, where a file holds several)."""
    found: dict[str, type[Simulator]] = {}
    for info in pkgutil.iter_modules(simulators.__path__):
        kinds = list(_in_module(f"{simulators.__name__}.{info.name}"))
        for kind in kinds:
            found[info.name if len(kinds) == 1 else f"{info.name}.{kind.__name__}"] = kind
    return found


def find(name: str) -> type[Simulator]:
    """The simulator of this name; raises KinegraphError with the nearest there is."""
    known = named()
    if name in known:
        return known[name]
    module, _, kind = name.rpartition(".")
    if module:
        try:
            candidate = getattr(importlib.import_module(module), kind, None)
        except ImportError as error:
            raise KinegraphError(f"{module} cannot be imported: {explain(error)}") from None
        if _is_simulator(candidate):
            return candidate  # type: ignore[return-value]
    raise KinegraphError(f"there is no simulator {name!r}; {nearest(name, known)}")


def _in_module(name: str) -> Iterator[type[Simulator]]:
    try:
        module = importlib.import_module(name)
    except ImportError:  # it needs an extra that is not installed
        return
    for member in vars(module).values():
        if _is_simulator(member) and member.__module__ == name:
            yield member


def _is_simulator(candidate: object) -> bool:
    return inspect.isclass(candidate) and issubclass(candidate, Simulator) and is_dataclass(candidate)
