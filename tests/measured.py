"""A command in a process of its own, with what it took: its peak of memory in MB and its seconds of processor time."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from tests.command_line import KINEGRAPH

MOST_MB = 500.0
"""So much memory may the reading of a file of 10 MB from a stranger take, all in all."""


class Measured(NamedTuple):
    code: int
    out: str
    err: str
    peak_mb: float
    cpu_s: float


def measured(*arguments: object, folder: Path, env: dict[str, str] | None = None) -> Measured:
    """Call `kinegraph` with these arguments."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = subprocess.Popen(
            [KINEGRAPH, *map(str, arguments)], cwd=folder, stdout=out, stderr=err, env={**os.environ, **(env or {})}
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode())
    return Measured(child.returncode, *texts, used.ru_maxrss / 1024, used.ru_utime + used.ru_stime)
