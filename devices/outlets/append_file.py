"""A text file that grows by whole lines, survives a killed process and a full disk, and can be cut back to what a checkpoint knew."""

from __future__ import annotations

import os
import time
from pathlib import Path

import structlog

from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.atomic_file import PRIVATE

RETRY_S = 1.0
PENDING_BYTES = 8 << 20
"""At most this much waits in memory for a disk that is full."""

log = structlog.get_logger(__name__)


class AppendFile:
    """Lines go to the operating system at once, so that `kill -9` loses nothing.

    When writing fails, lines wait in memory and are tried again every second; what does not fit there is dropped and counted.

    offset    bytes written
    pending   bytes that wait for a disk that takes them; they follow `offset`
    dropped   lines dropped so far
    """

    def __init__(self, path: Path, offset: int = 0, pending: bytes = b"", *, fresh: bool = True) -> None:
        """Create the file, or (not `fresh`) cut it back to `offset` and go on. Raises DeviceError."""
        self.path, self.offset, self.pending, self.dropped = path, offset, pending, 0
        self._failing = False
        self._retry_at = 0.0
        try:
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | (os.O_EXCL if fresh else 0), PRIVATE)
        except FileExistsError:
            raise DeviceError(f"{path} exists already; it is not overwritten (existing: replace allows it)") from None
        except OSError as error:
            raise DeviceError(f"cannot write {path}: {error.strerror}; choose another path") from None
        if not fresh:
            self._cut_back()

    def write(self, lines: bytes) -> int:
        """Append whole lines. Returns how many lines had to be dropped instead (all or 0)."""
        if len(self.pending) + len(lines) > PENDING_BYTES and not self._flush():
            lost = lines.count(b"\n")
            self.dropped += lost
            return lost
        self.pending += lines
        self._flush()
        return 0

    def sync(self) -> None:
        """Bring what is written past every cache, so that a power cut does not lose it."""
        try:
            os.fsync(self._handle)
        except OSError as error:
            if not self._failing:
                log.error("file may not be on the disk yet", path=str(self.path), error=error.strerror)

    def close(self) -> None:
        """Write what waits, make it durable. Raises DeviceError if lines are lost for good."""
        self._retry_at = 0.0
        written = self._flush()
        lost = self.dropped + self.pending.count(b"\n")
        is_gone = not self.path.exists()
        try:
            os.fsync(self._handle)
        except OSError as error:
            log.error("file may not be on the disk yet", path=str(self.path), error=error.strerror)
        finally:
            os.close(self._handle)
        if is_gone:
            raise DeviceError(f"{self.path} was deleted or moved while it was written")
        if not written or lost:
            raise DeviceError(
                f"{lost} rows of {self.path} could not be written: the disk was full or failing; free some space"
            )

    def _flush(self) -> bool:
        """Write what is pending; returns whether nothing is left."""
        if not self.pending:
            return True
        if self._failing and time.monotonic() < self._retry_at:
            return False
        try:
            while self.pending:
                n = os.pwrite(self._handle, self.pending, self.offset)
                self.offset += n
                self.pending = self.pending[n:]
        except OSError as error:
            self._fails(error)
            return False
        if self._failing:
            self._failing = False
            log.info("file is written again", path=str(self.path), rows_dropped=self.dropped)
        return True

    def _fails(self, error: OSError) -> None:
        self._retry_at = time.monotonic() + RETRY_S
        if not self._failing:
            self._failing = True
            log.error(
                "cannot write file; rows wait in memory",
                path=str(self.path),
                error=error.strerror,
                retry_every_s=RETRY_S,
                memory_bytes=PENDING_BYTES,
            )

    def _cut_back(self) -> None:
        """Remove what was written after the checkpoint. A file shorter than that (a power cut) goes on after its last whole line."""
        size = os.fstat(self._handle).st_size
        if size < self.offset:
            head = os.pread(self._handle, size, 0)
            kept = head.rfind(b"\n") + 1
            log.error(
                "file is shorter than at the checkpoint; rows are missing in it (the recording has them)",
                path=str(self.path),
                bytes_missing=self.offset - kept,
            )
            self.offset, self.pending = kept, b""
        os.ftruncate(self._handle, self.offset)
