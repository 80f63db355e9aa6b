"""Writes the nights of a folder: one that goes on, those that are over and not on the disk yet; old ones are deleted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import structlog

from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.archive import Facts, nanoseconds
from kinegraph.devices.reports.night.log_state import LogState
from kinegraph.devices.reports.night.recount import recounted
from kinegraph.devices.reports.night.renderer import ReportRenderer
from kinegraph.devices.reports.night.writing import OpenNight, readable, write_map
from kinegraph.stream.chunk import NEVER, NS, Array
from kinegraph.stream.errors import DeviceError

APART_NS = 4 * 3600 * NS
"""So long after anyone was in bed, what follows is another night, whatever the statistics say."""
MAX_WAITING = 3000
"""This many epochs wait for a disk that takes no new folder: a day."""

log = structlog.get_logger(__name__)


class NightWriter:
    """
    root      the folder of all nights
    sleeper   the sleeper's name, if the folder has several
    facts_of  what is known of a night that begins: (onset) -> facts, but for the folder's name
    has_seen  whether it is known who was in bed when
    """

    def __init__(
        self,
        root: Path,
        state: LogState,
        facts_of: Callable[[int], Facts],
        *,
        sleeper: str,
        has_seen: bool,
        keep_days: float,
        report: bool,
    ) -> None:
        """`keep_days`: older nights are deleted, 0: never; `report`: whether nights are drawn."""
        self.root, self._state, self._facts_of = root, state, facts_of
        self._sleeper, self._told, self._keep_days = sleeper, has_seen, keep_days
        self._renderer = ReportRenderer() if report else None
        self.night: OpenNight | None = None
        self._over: list[OpenNight] = []
        """Nights that are over, and not on the disk yet as they should be: it is full."""
        self._deleted = NEVER
        """Onset of the epoch before which the open night was deleted by somebody; its numbers are then of what is no more."""
        self._former: Path | None = None
        """The night that was closed last."""
        self._former_end = NEVER
        self.last = NEVER
        """Onset of the newest epoch in a log."""
        self._waiting: list[dict[str, Any]] = []
        """Rows of a night without a folder yet: the disk is full."""
        self.lost: list[str] = []

    def resume(self, now: int, held: Iterable[int]) -> None:
        """Go on with the night that was broken off, if there is one.

        `now`: when this session began (ns), NEVER in replay; `held`: onsets of epochs that are known and not final.
        """
        broken_off = None
        for folder, facts in archive.nights(self.root):
            epochs = readable(folder)
            if facts.sleeper != self._sleeper or not len(epochs) or self._of_another_clock(folder, facts, epochs, now):
                continue
            self.last = max(self.last, int(epochs.onset[-1]))
            if facts.closed:
                self._former, self._former_end = folder, int(facts.numbers.get("end", self.last))
                self._state.rests = self._state.rests or str(epochs.texts["bed"][-1]) == "in"
            else:
                broken_off = folder, facts, epochs
        if broken_off:
            self.night = OpenNight.go_on(*broken_off)
            self.night.facts.run = self._state.run
            length, written = round(self.night.facts.epoch_s * NS), int(broken_off[2].end[-1])
            if now != NEVER:  # from the last epoch that is known, final or not, to now, the camera was off
                begin = min(now, max([written, *(onset + length for onset in held)]))
                self.night.note(self.night.facts.breaks, [begin, now])
                log.info("the night goes on", night=self.night.folder.name, away_s=(now - begin) // NS)

    def _of_another_clock(self, folder: Path, facts: Facts, epochs: archive.LoggedEpochs, now: int) -> bool:
        """Whether an earlier session's night lies ahead of this one's beginning: a simulated one, or the clock has been wrong.

        Such a night is over, and what is seen now is not taken for what it holds already.
        """
        ahead = now != NEVER and int(epochs.onset[-1]) > now + round(facts.epoch_s * NS)
        if facts.run == self._state.run or not ahead:
            return False
        log.warning("a night in the log lies in the future; another one begins beside it", night=folder.name)
        if not facts.closed:
            facts.closed = True
            with suppress(OSError):
                facts.save(folder)
        return True

    def write(self, onset: int, row: dict[str, Any], bed: str, state: str) -> None:
        """A final epoch, and whether somebody was in `bed`: a row of the night that goes on, or the first of another one."""
        self.settle()
        self._forget_deleted(onset)
        if self._begins_or_goes_on(onset, bed, state):
            self.last = onset
            self._waiting = [*self._waiting[-MAX_WAITING:], row]
            self._write_waiting()

    def _begins_or_goes_on(self, onset: int, bed: str, state: str) -> bool:
        """Whether an epoch belongs to a night: one that is open (or waits for the disk), or one that begins with it."""
        night = self.night
        here = bed == "in" if self._told else state != "unknown"
        if night is not None and onset - night.in_bed > APART_NS:
            if not here:
                return False
            self._shut(night)
            night = self.night = None
        if bed == "out" or onset > self._former_end + APART_NS:
            self._state.rests = False
        if night is not None and here:
            night.in_bed = onset
        if night is not None or self._waiting:
            return True
        return here and not self._state.rests and (self._told or onset >= self._former_end + APART_NS)

    def _write_waiting(self) -> None:
        """Write what waits, in a new folder if need be; a disk that is full is tried again with the next epoch."""
        if self.night is None:
            try:
                self.night = self._begun(nanoseconds(self._waiting[0]["onset"]))
            except (OSError, DeviceError) as error:
                log.error(
                    "the night has no folder yet; its epochs wait in memory", path=str(self.root), error=str(error)
                )
                return
        for row in self._waiting:
            self.night.write(row)
        self._waiting = []

    def _begun(self, onset: int) -> OpenNight:
        facts = self._facts_of(onset)
        zone = archive.zone_of(facts.timezone)
        folder = archive.new_folder(self.root, onset, zone)
        facts.name = folder.name
        night = OpenNight.begin(folder, facts)
        log.info("a night begins", night=folder.name, at=str(archive.clock(onset, zone)))
        return night

    def end(self, numbers: dict[str, Any]) -> None:
        """The numbers of a night that is over."""
        night = self.night
        if night is None or not numbers["onset"] - APART_NS < night.facts.begun < numbers["end"]:
            return
        if numbers["onset"] >= self._deleted:
            night.facts.numbers = {k: (None if v != v else v) for k, v in numbers.items()}
            if not night.file.pending:
                night.facts.numbers = recounted(night.facts, readable(night.folder))
        self._former, self._former_end, self.night, self._deleted = night.folder, numbers["end"], None, NEVER
        self._state.rests = True
        log.info("the night is over", night=night.folder.name, folder=str(night.folder))
        self._shut(night)
        if self._keep_days:
            _delete_old(self.root, self._keep_days, numbers["end"])

    def map(self, frame: Array) -> None:
        """The map comes with the night's numbers, before or after them."""
        folder = self.night.folder if self.night else self._former
        written = folder is not None and folder.is_dir() and write_map(folder, frame)
        if folder and written and self.night is None and self._renderer:
            self._renderer.soon(folder)

    def look(self) -> None:
        """See to pages that are due."""
        if self._renderer:
            self._renderer.look()

    def settle(self) -> None:
        """See that nights that are over are on the disk, and have them drawn."""
        for night in [*self._over]:
            if night.deleted or night.shut():
                self._over.remove(night)
                self.lost.append(night.let_go())
                if self._renderer and not night.deleted:
                    self._renderer.soon(night.folder)

    def close(self) -> None:
        """Write what is left, and wait for pages that are being drawn; the open night may go on in another session."""
        self.settle()
        for late in self._over:
            self.lost.append(late.let_go())
        try:
            if self._renderer:
                self._renderer.finish()
        finally:
            night, self.night = self.night, None
            if night:
                night.save()
                night.file.close()

    @property
    def undelivered(self) -> str:
        """What is missing in the log, in words; "" where nothing is."""
        waiting = f"{len(self._waiting)} epochs could not be written to {self.root}" if self._waiting else ""
        return "; ".join(filter(None, [*self.lost, waiting]))

    def _shut(self, night: OpenNight) -> None:
        self._over.append(night)
        self.settle()

    def _forget_deleted(self, onset: int) -> None:
        """The open night was deleted while it went on: what follows gets a folder of its own."""
        if self.night is not None and self.night.deleted:
            log.warning(
                "the night was deleted while it was running; the rest is kept in another folder",
                night=self.night.folder.name,
            )
            self.lost.append(self.night.let_go())
            self.night, self._deleted = None, onset


def _delete_old(root: Path, keep_days: float, now: int) -> None:
    """Delete nights that are older than they may become."""
    oldest = now - keep_days * 86_400 * NS
    old = [folder for folder, facts in archive.nights(root) if facts.closed and facts.begun < oldest]
    old += [folder for folder in archive.damaged(root) if folder.stat().st_mtime_ns < oldest]
    for folder in old:
        try:
            archive.remove(folder)
            log.info("an old night was deleted", night=folder.name, keep_days=keep_days)
        except DeviceError as error:
            log.error(str(error))
