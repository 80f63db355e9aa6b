"""The newest report of a folder of nights, as a home learns of it: one line, and where it stands."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinegraph.devices.mqtt.discovery import Device, Topics, shared

EVERY_S = 5.0
"""How often a folder is looked at, in the machine's time: another process draws the report, without notice."""
NAME = "report"


@dataclass(frozen=True, slots=True)
class ReportNews:
    """Tell when a night's report is ready: an entity "Report" with the night in one line as its state, and `night` and `address` beside it.

    nights    the folder of all nights, as `devices.reports.night.NightLog` has it
    address   what the folder is reached at from elsewhere, e.g. http://pi.local:8000; left out: the file's own path
    sleeper   the sleeper's name, if there are several
    """

    nights: str
    address: str = ""
    sleeper: str = ""


class ReportWatch:
    """Looks for a new report, and returns what to send: (topic, text)."""

    def __init__(self, news: ReportNews, topics: Topics) -> None:
        self._news, self._topics = news, topics
        self._looked = -EVERY_S
        self._told: tuple[str, int] = ("", 0)

    def look(self, *, now: bool = False) -> list[tuple[str, str]]:
        """Empty without a report that was not announced yet."""
        moment = time.monotonic()
        if not now and moment - self._looked < EVERY_S:
            return []
        self._looked = moment
        from kinegraph.devices.reports.night import archive
        from kinegraph.devices.reports.night.summary import headline

        root = Path(self._news.nights).absolute()
        found: list[tuple[int, Path]] = []
        for page in root.glob(f"*/{archive.DRAWN[0]}"):
            try:
                found.append((page.stat().st_mtime_ns, page))
            except OSError:
                continue  # deleted meanwhile
        for drawn, page in sorted(found, reverse=True):
            key = str(page), drawn
            if key == self._told:
                return []
            try:
                facts = archive.Facts.load(page.parent)
            except archive.NightError:
                continue
            if not facts.closed or facts.sleeper != self._news.sleeper:
                continue
            self._told = key
            about = {"night": page.parent.name, "address": self._address(page), "sleeper": facts.sleeper}
            return [(self._topics.attributes(NAME), json.dumps(about)), (self._topics.state(NAME), headline(facts))]
        return []

    def _address(self, page: Path) -> str:
        base = self._news.address.rstrip("/")
        return f"{base}/{page.parent.name}/{page.name}" if base else page.as_uri()


def report_announcement(device: Device, topics: Topics) -> dict[str, Any]:
    """The discovery message of the report."""
    return {
        **shared(NAME, "Report", device, topics.availability()),
        "state_topic": topics.state(NAME),
        "json_attributes_topic": topics.attributes(NAME),
        "icon": "mdi:file-chart-outline",
    }
