"""The night that is being written: its folder, its rows, its facts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from kinegraph.devices.outlets.append_file import AppendFile
from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.archive import COLUMNS, EPOCHS, MAP, Facts
from kinegraph.stream.chunk import Array
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.atomic_file import complete, private_folder

MAX_LISTED = 500
"""At most this many bed exits, switchings and breaks are kept of a night."""

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class OpenNight:
    """
    in_bed   the onset of the last epoch in which somebody was
    stale    its facts are not on the disk yet
    columns  of its table: fewer where an older version began it
    """

    folder: Path
    facts: Facts
    file: AppendFile
    in_bed: int
    stale: bool = False
    columns: tuple[str, ...] = COLUMNS

    @classmethod
    def begin(cls, folder: Path, facts: Facts) -> OpenNight:
        """Make the folder and the table of epochs. Raises OSError or DeviceError."""
        private_folder(folder)
        try:
            night = cls(folder, facts, AppendFile(folder / EPOCHS), facts.begun)
        except DeviceError:
            folder.rmdir()
            raise
        night.file.write((",".join(COLUMNS) + "\n").encode())
        night.save()
        return night

    @classmethod
    def go_on(cls, folder: Path, facts: Facts, epochs: archive.LoggedEpochs) -> OpenNight:
        """A night that was broken off: a row that was being written is cut off."""
        text = (folder / EPOCHS).read_bytes()
        file = AppendFile(folder / EPOCHS, text.rfind(b"\n") + 1, fresh=False)
        there = epochs.texts["bed"] == "in"
        in_bed = int(epochs.onset[there][-1] if there.any() else epochs.onset[-1])
        return cls(folder, facts, file, in_bed, columns=tuple(text.decode().partition("\n")[0].strip().split(",")))

    def write(self, row: dict[str, Any]) -> None:
        """One epoch, past every cache; while the disk is full it waits in memory."""
        self.file.write((",".join(str(row.get(name, "")) for name in self.columns) + "\n").encode())
        self.file.sync()
        if self.stale:
            self.save()

    def note(self, entries: list[list[Any]], entry: list[Any]) -> None:
        """One more entry of a list of the facts, unless it stands there."""
        if entry not in entries and len(entries) < MAX_LISTED:
            entries.append(entry)
            self.save()

    def save(self) -> None:
        """Write the facts; a disk that is full is tried again with the next epoch."""
        try:
            self.facts.save(self.folder)
            self.stale = False
        except OSError as error:
            if not self.stale:
                log.error("cannot write the night's facts", folder=str(self.folder), error=error.strerror)
            self.stale = True

    @property
    def deleted(self) -> bool:
        """Whether somebody has removed what was written."""
        return not (self.folder / EPOCHS).exists()

    def shut(self) -> bool:
        """The night is over. Whether everything is on the disk; if not, this is asked again when there may be room."""
        self.facts.closed = True
        self.save()
        self.file.write(b"")
        return not self.stale and not self.file.pending

    def let_go(self) -> str:
        """Close the file. What could not be written is reported, ends nothing else, and is returned in words; "": nothing."""
        try:
            self.file.close()
        except DeviceError as error:
            log.error(str(error))
            return str(error)
        return ""


def readable(folder: Path) -> archive.LoggedEpochs:
    """A night's epochs; if they cannot be read, empty, with a warning in the log."""
    try:
        return archive.read_epochs(folder)
    except archive.NightError as error:
        log.error("a night cannot be read", folder=str(folder), error=str(error))
        nothing = np.empty(0, np.int64)
        return archive.LoggedEpochs(nothing, nothing, {}, {})


def write_map(folder: Path, frame: Array) -> bool:
    """The night's motion map, whole or not at all; whether it stands there."""
    try:
        with complete(folder / MAP) as draft, draft.open("wb") as file:
            np.save(file, frame)
    except OSError as error:
        log.error("cannot write the motion map", folder=str(folder), error=error.strerror)
        return False
    return True
