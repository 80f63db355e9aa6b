"""A disk that keeps every write in order, so that any moment's power loss can be made of it: a file in a file system of its own (FUSE).

`python logged_disk.py IMAGE FOLDER LOG` shows IMAGE as FOLDER/disk.img until it is unmounted; a loop device may lie over it.
"""

from __future__ import annotations

import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

HEAD = struct.Struct("<cqq")
WRITE, FLUSH = b"w", b"f"
SECTOR = 512


def events(log: Path) -> Iterator[tuple[bytes, int, bytes]]:
    """What was asked of the disk, in order: (WRITE, offset, data) or (FLUSH, 0, b"")."""
    with log.open("rb") as file:
        while len(head := file.read(HEAD.size)) == HEAD.size:
            kind, offset, size = HEAD.unpack(head)
            yield kind, offset, file.read(size)


def after_power_loss(image: Path, log: Path, moment: int, rng: np.random.Generator, to: Path) -> int:
    """The disk as the power went after so many events: what was flushed is there; of each later write nothing, some sectors, or all.

    Returns how many writes had not been flushed.
    """
    asked = [event for event, _ in zip(events(log), range(moment), strict=False)]
    flushed = max((k for k, (kind, *_) in enumerate(asked) if kind == FLUSH), default=0)
    to.write_bytes(image.read_bytes())
    loose = 0
    with to.open("r+b") as file:
        for k, (kind, offset, data) in enumerate(asked):
            if kind == FLUSH:
                continue
            if k > flushed:
                loose += 1
                data = data[
                    : SECTOR * int(rng.choice([0, rng.integers(0, len(data) // SECTOR + 1), len(data) // SECTOR]))
                ]
            file.seek(offset)
            file.write(data)
    return loose


def serve(image: Path, folder: Path, log: Path) -> None:
    import mfusepy

    class Disk(mfusepy.Operations):  # type: ignore[misc]
        """One file, every write of which is noted before it is done."""

        use_ns = True

        def __init__(self) -> None:
            self.file = os.open(image, os.O_RDWR)
            self.log = log.open("wb", buffering=0)

        def getattr(self, path: str, fh: Any = None) -> dict[str, Any]:
            if path == "/":
                return {"st_mode": 0o40700, "st_nlink": 2}
            if path != "/disk.img":
                raise mfusepy.FuseOSError(2)
            return {"st_mode": 0o100600, "st_nlink": 1, "st_size": os.fstat(self.file).st_size}

        def readdir(self, path: str, fh: Any) -> list[str]:
            return [".", "..", "disk.img"]

        def read(self, path: str, size: int, offset: int, fh: Any) -> bytes:
            return os.pread(self.file, size, offset)

        def write(self, path: str, data: bytes, offset: int, fh: Any) -> int:
            self.log.write(HEAD.pack(WRITE, offset, len(data)) + data)
            return os.pwrite(self.file, data, offset)

        def fsync(self, path: str, datasync: int, fh: Any) -> int:
            self.log.write(HEAD.pack(FLUSH, 0, 0))
            return 0

    mfusepy.FUSE(Disk(), str(folder), foreground=True, nothreads=True)


if __name__ == "__main__":
    serve(*map(Path, sys.argv[1:]))
