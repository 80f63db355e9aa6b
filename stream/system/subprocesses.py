"""Processes of our own beside a command: Python without the current folder among the places where it looks for modules."""

from __future__ import annotations

import sys


def child(module: str, *arguments: str) -> list[str]:
    """The command that runs a module; not, in place of one of Python's own, a file of its name in the folder we were called in."""
    return [sys.executable, "-P", "-m", module, *arguments]
