"""How a session shows itself while it runs, and what is left to say when it has ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from stream.engine.status import Table


class View(Protocol):
    """Something that shows a running session."""

    def update(self, table: Table) -> None:
        """Take the newest metrics, once a second; must not wait."""


@dataclass(slots=True)
class Outcome:
    """How a session ended.

    exit_code   0 well, 3 a device was missing, 4 the graph stopped by an error, 5 an outlet or the recording lost something
    table       the last metrics
    seconds     from the common opening of the devices to their end
    files       what outlets have left, by node
    compiled    kernels that were compiled while running; there should be none
    """

    error: Exception | None
    exit_code: int
    table: Table
    folder: Path | None
    compiled: list[str]
    seconds: float = 0.0
    files: dict[str, str] = field(default_factory=dict)
