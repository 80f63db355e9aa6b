"""Formats that are entry points, from kinegraph or any other package."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from kinegraph.stream.system.entry_points import loaded


def installed(group: str, kind: str) -> dict[str, Any]:
    """Everything installed in a group of entry points, by name; raises KinegraphError for one that cannot be loaded."""
    found: dict[str, Any] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        found[entry.name] = loaded(entry, kind)
    return found
