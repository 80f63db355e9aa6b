"""What installed packages add to kinegraph by entry points."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from kinegraph.stream.errors import KinegraphError, explain


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
