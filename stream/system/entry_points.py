"""What installed packages add to kinegraph by entry points."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from kinegraph.stream.errors import KinegraphError, explain
from kinegraph.stream.text.safe_text import say


def loaded(entry: EntryPoint, kind: str) -> Any:
    """What an entry point names; raises KinegraphError where it cannot be loaded: its module may have gone since it was installed."""
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        package = entry.dist.name if entry.dist else ""
        again = f"; if {package} has changed since it was installed, install it again" if package else ""
        raise KinegraphError(
            f"the {kind} {entry.name} ({entry.value}) cannot be loaded: {explain(error)}{again}"
        ) from None


def usable(group: str, kind: str) -> Iterator[tuple[str, Any]]:
    """Name and function of every entry point of a group. One that cannot be loaded is named on standard error and left out."""
    for entry in entry_points(group=group):
        try:
            yield entry.name, loaded(entry, kind)
        except KinegraphError as error:
            say(f"kinegraph: {error}", err=True)
