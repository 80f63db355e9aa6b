"""Processes of our own beside a command."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress


def child(module: str, *arguments: str) -> list[str]:
    """The command that runs a module of ours, never a file of the same name in the current folder."""
    return [sys.executable, "-P", "-m", module, *arguments]


def yield_processor(process: subprocess.Popen[bytes]) -> None:
    """Lower the priority of a process that draws or writes, so that the graph comes first. No fault where the system refuses."""
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, process.pid, 10)


def complaint(process: subprocess.Popen[bytes]) -> str:
    """The last line of what a process that has ended wrote to stderr; "": it has succeeded. Closes its stderr."""
    lines = process.stderr.read().decode(errors="replace").strip().splitlines()[-1:] if process.stderr else []
    if process.stderr:
        process.stderr.close()
    return (lines[0] if lines else "no reason given") if process.returncode else ""
