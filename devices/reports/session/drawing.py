"""A report's page, drawn by a process of its own, so that no graph waits for it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import structlog

from kinegraph.devices.reports.session.contents.data import Curves, Report, save
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.subprocesses import child, yield_processor

DRAWING_S = 180.0

log = structlog.get_logger(__name__)


class PageDrawing:
    """Draws pages, one at a time. A page STEM.html is drawn from .STEM.npz, which goes once the last page is there."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        """What draws an interim page."""

    def begin(self, stem: Path, report: Report, curves: Curves) -> None:
        """Begin to draw an interim page; whatever goes wrong with it is reported and does not matter."""
        try:
            self._process = _start(stem, report, curves)
        except OSError as error:
            log.warning("interim report not drawn", error=str(error))

    @property
    def busy(self) -> bool:
        """Whether an interim page is being drawn."""
        return self._process is not None and self._process.poll() is None

    def stop(self) -> None:
        """Give up the interim page that is being drawn."""
        if self._process:
            self._process.kill()
            self._process.wait()

    def draw(self, stem: Path, report: Report, curves: Curves) -> None:
        """Draw the last page, and wait for it. Raises DeviceError."""
        page, data = stem.with_name(f"{stem.name}.html"), _data(stem)
        try:
            process = _start(stem, report, curves)
            _, complaint = process.communicate(timeout=DRAWING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise DeviceError(
                f"report {page}: drawing took more than {DRAWING_S:g} s; its data are in {data}"
            ) from None
        except OSError as error:
            raise DeviceError(f"report {page}: cannot be written: {error.strerror or error}") from None
        if process.returncode:
            last = complaint.decode(errors="replace").strip().splitlines()[-1:] or ["no reason given"]
            raise DeviceError(f"report {page} could not be drawn: {last[0]}; its data are in {data}")
        data.unlink(missing_ok=True)
        log.info("report written", page=str(page), table=f"{stem}.csv")


def _start(stem: Path, report: Report, curves: Curves) -> subprocess.Popen[bytes]:
    save(_data(stem), report, curves)
    command = child("kinegraph.devices.reports.session.page", str(_data(stem)), f"{stem}.html")
    to = subprocess.DEVNULL if report.interim else subprocess.PIPE
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=to, start_new_session=True)
    if report.interim:
        yield_processor(process)
    return process


def _data(stem: Path) -> Path:
    return stem.with_name(f".{stem.name}.npz")
