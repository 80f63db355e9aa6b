"""What belongs to a running log of nights but not to its state."""

from __future__ import annotations

from datetime import tzinfo
from typing import Any

from filelock import FileLock

from kinegraph.devices.reports.night.night_writer import NightWriter
from kinegraph.stream.chunk import NEVER, Specs
from kinegraph.stream.graph import Graph


class LogRuntime:
    """Specs, the graph, the clock, and who writes."""

    def __init__(self, specs: Specs) -> None:
        self.specs = specs
        self.graph: Graph | None = None
        self.lock: FileLock | None = None
        self.zone: tzinfo | None = None
        self.writer: NightWriter | None = None
        self.now = NEVER
        """When this session began; NEVER in replay."""
        self.held: dict[int, dict[str, Any]] = {}
        """What is known of epochs that are not final yet, by onset."""
        self.switched: list[Any] = []
        """When the lights were switched last, and to what."""
