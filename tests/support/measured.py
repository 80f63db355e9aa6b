"""A command in a process of its own, with what it took: its peak of memory in MB and its seconds of processor time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from tests.support.command_line import KINEGRAPH

MOST_MB = 500.0
"""So much memory may the reading of a file of 10 MB from a stranger take, all in all."""


MOST_S = 10.0
"""And so much processor time."""


class Measured(NamedTuple):
    code: int
    out: str
    err: str
    peak_mb: float
    cpu_s: float


MEASURE = """
import json, os, resource, subprocess, sys
code = subprocess.run(sys.argv[2:]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
json.dump([code, used.ru_maxrss / 1024, used.ru_utime + used.ru_stime], open(sys.argv[1], "w"))
"""
"""A small process in between: a child's peak begins with the memory of whoever starts it, and a process of tests holds much."""


def measured(*arguments: object, folder: Path, env: dict[str, str] | None = None) -> Measured:
    """Call `kinegraph` with these arguments."""
    with tempfile.NamedTemporaryFile("r") as used:
        call = [sys.executable, "-S", "-c", MEASURE, used.name, KINEGRAPH, *map(str, arguments)]
        done = subprocess.run(
            call, cwd=folder, capture_output=True, text=True, env={**os.environ, **(env or {})}, check=True
        )
        code, peak_mb, cpu_s = json.load(used)
    return Measured(code, done.stdout, done.stderr, peak_mb, cpu_s)
