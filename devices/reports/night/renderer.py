"""Draws the reports: one separate process at a time, in the background, retried a few times when it fails."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import structlog

from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.subprocesses import child, complaint, yield_processor

SETTLE_S, LONGEST_S = 1.0, 300.0
AGAIN_S = (60.0, 300.0, 1800.0, 7200.0)
"""How long after each failure a report is tried again; after the last it is left until the session ends, or its night changes."""

log = structlog.get_logger(__name__)


class ReportRenderer:
    """`soon` orders the report of a night's folder, `look` sees to what is due and never waits, `finish` waits for what was ordered."""

    def __init__(self) -> None:
        self._due: dict[Path, float] = {}
        self._at_work: tuple[subprocess.Popen[bytes], Path] | None = None
        self._failures: dict[Path, int] = {}
        self._left: dict[Path, None] = {}
        """Reports that were tried often enough; tried once more at the end."""

    def soon(self, folder: Path) -> None:
        """A report in a moment: what belongs to it may still be on its way."""
        self._due[folder] = time.monotonic() + SETTLE_S
        self._failures.pop(folder, None)
        self._left.pop(folder, None)

    def look(self) -> None:
        """Begin what is due, and see how the last one ended."""
        if self._at_work:
            process, folder = self._at_work
            if process.poll() is None:
                return
            self._at_work = None
            why = complaint(process)
            if why and folder.is_dir():
                self._again(folder, why)
            elif not why:
                _written(folder)
        for folder, when in self._due.items():
            if time.monotonic() >= when:
                self._begin(folder)
                return

    def finish(self) -> None:
        """Everything that was ordered, now and once. Raises DeviceError, which names every report that is not whole, and why."""
        failed: list[str] = []
        self._due |= dict.fromkeys(self._left, 0.0)
        self._left.clear()
        while self._at_work or self._due:
            if not self._at_work:
                self._begin(next(iter(self._due)))
            if not self._at_work:
                raise DeviceError(
                    "no process could be started to draw the report: try `kinegraph sleep nights report last`"
                )
            process, folder = self._at_work
            self._at_work = None
            try:
                process.wait(LONGEST_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            why = complaint(process)
            if not why:
                _written(folder)
            elif folder.is_dir():
                again = f"try `kinegraph sleep nights report {folder.name} --path {folder.parent}`"
                failed.append(f"the report of {folder} is not whole ({why}): {again}")
        if failed:
            raise DeviceError("\n".join(failed))

    def _begin(self, folder: Path) -> None:
        command = child("kinegraph.devices.reports.night.page", str(folder))
        del self._due[folder]
        try:
            process = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
            )
        except OSError as error:
            self._again(folder, str(error))
            return
        self._at_work = process, folder
        yield_processor(process)

    def _again(self, folder: Path, why: str) -> None:
        """A report has failed: once more after a while, or not before the end; the first failure and the last are reported."""
        failures = self._failures[folder] = self._failures.get(folder, 0) + 1
        if failures > len(AGAIN_S):
            self._left[folder] = None
            log.error("report postponed until the session ends", night=folder.name, why=why, failures=failures)
            return
        self._due[folder] = time.monotonic() + AGAIN_S[failures - 1]
        if failures == 1:
            log.error("report incomplete; it is tried again a few times", night=folder.name, why=why)


def _written(folder: Path) -> None:
    log.info("report written", page=str(folder / "report.html"))
