"""The simulators by name: that of a device's folder (`cyton`), or anyone's by its dotted path (`my_lab.board.Board`)."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from dataclasses import is_dataclass

from kinegraph import devices
from kinegraph.devices.simulation.serve import Simulator
from kinegraph.stream.errors import KinegraphError, explain, nearest
from kinegraph.stream.system.names import module_of


def named() -> dict[str, type[Simulator]]:
    """Every simulator of ours, by the name of its device: `devices/cyton/simulator.py` is "cyton"."""
    found: dict[str, type[Simulator]] = {}
    for folder in pkgutil.iter_modules(devices.__path__):
        for info in pkgutil.iter_modules([f"{next(iter(devices.__path__))}/{folder.name}"]) if folder.ispkg else ():
            if info.name == "simulator" or info.name.endswith("_simulator"):
                name = info.name.removesuffix("simulator").removesuffix("_") or folder.name
                for kind in _in_module(f"{devices.__name__}.{folder.name}.{info.name}"):
                    found[name] = kind
    return found


def find(name: str) -> type[Simulator]:
    """The simulator of this name; raises KinegraphError with the nearest there is."""
    known = named()
    if name in known:
        return known[name]
    module, _, kind = name.rpartition(".")
    if module:
        try:
            candidate = getattr(importlib.import_module(module_of(module)), kind, None)
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
