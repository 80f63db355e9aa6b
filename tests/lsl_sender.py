"""A simulated LSL sender in a process of its own, which can be killed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Process:
    """`kinegraph simulate lsl` with these settings, once it says that it is there."""

    def __init__(self, **settings: Any) -> None:
        given = [f"{name}={value}" for name, value in settings.items()]
        command = [sys.executable, "-m", "stream", "simulate", "lsl", *given, "--for", "60"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self._process.stdout and self._process.stderr
        said = self._process.stdout.readline()
        assert said.startswith("LSL stream"), said + self._process.stderr.read()

    def kill(self) -> None:
        """As a crash or a power cut ends it."""
        self._process.kill()
        self._process.communicate()


@contextmanager
def process(**settings: Any) -> Iterator[Process]:
    """Within: the sender is there, unless it is killed."""
    sender = Process(**settings)
    try:
        yield sender
    finally:
        sender.kill()
