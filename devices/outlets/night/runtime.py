"""What a night's log remembers: its state, and what belongs to a running one only."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import tzinfo
from pathlib import Path
from typing import Any

from filelock import FileLock

from devices.outlets.night.renderer import ReportRenderer
from devices.outlets.night.writing import OpenNight
from stream.chunk import NEVER, Specs
from stream.graph import Graph


@dataclass(slots=True)
class LogState:
    """
    held   what is known of epochs that are not final yet, as JSON by onset
    bed    what the bed is now
    rests  the night is over, but somebody is still in bed: the next begins when the bed was left
    run    which session this is, over all its restarts
    """

    held: str = "{}"
    bed: str = ""
    rests: bool = False
    run: str = ""


class LogRuntime:
    """What belongs to a running outlet but not to its state: files, and the night that is being written."""

    def __init__(self, specs: Specs) -> None:
        self.specs = specs
        self.graph: Graph | None = None
        self.claim: FileLock | None = None
        self.zone: tzinfo | None = None
        self.night: OpenNight | None = None
        self.over: list[OpenNight] = []
        """Nights that are over, and not on the disk yet as they should be: it is full."""
        self.deleted = NEVER
        """Onset of the epoch before which the open night was deleted by somebody; its numbers are then of what is no more."""
        self.former: Path | None = None
        """The night that was closed last."""
        self.former_end = NEVER
        self.now = NEVER
        """When this session began; NEVER in replay."""
        self.held: dict[int, dict[str, Any]] = {}
        """What is known of epochs that are not final yet, by onset."""
        self.last = NEVER
        """Onset of the newest epoch in a log."""
        self.waiting: list[dict[str, Any]] = []
        """Rows of a night whose folder could not be made yet: the disk is full."""
        self.switched: list[Any] = []
        """When the lights were switched last, and to what."""
        self.renderer = ReportRenderer()
