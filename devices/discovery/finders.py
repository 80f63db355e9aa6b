"""What is connected: asked of every finder that the packages bring (entry-point group `kinegraph.discovery`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import entry_points

import structlog

GROUP = "kinegraph.discovery"

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """One thing that is connected.

    kind      "serial", "usb", "lsl", "oak", ...
    address   how to name it: a port, an id, a stream's name
    what      what it is, for people
    yaml      the node that reads it, as a graph writes it ("use: ..." and its parameters); "" if unknown
    note      what has to be known or done first: permissions, another program that has it
    """

    kind: str
    address: str
    what: str
    yaml: str = ""
    note: str = ""


Finder = Callable[[], Iterable[FoundDevice]]
"""Looks for one kind of device, in a few seconds at most; opens nothing that others may be using."""


def finders() -> dict[str, Finder]:
    """Every finder, by the kind of device that it looks for. One that cannot be loaded (an extra is missing) is left out, and logged."""
    known: dict[str, Finder] = {}
    for entry in entry_points(group=GROUP):
        try:
            known[entry.name] = entry.load()
        except ImportError as error:
            log.debug("finder left out", kind=entry.name, error=str(error))
    return dict(sorted(known.items()))


def look(finder: Finder) -> tuple[list[FoundDevice], str]:
    """What a finder finds, and, if it failed, why."""
    try:
        return list(finder()), ""
    except Exception as error:  # noqa: BLE001 - one kind of device that cannot be asked must not hide the others
        return [], f"{type(error).__name__}: {error}"
