"""A simulated LSL sender in a process of its own, which can be killed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ELSEWHERE = ["unshare", "--time", "--monotonic", "5000", "--uts", "--fork", "--kill-child"]
"""What Linux can do: a process with a monotonic clock 5000 s ahead, on a host that may be called anything."""


def can_be_elsewhere() -> bool:
    """Whether this computer lets us do that."""
    try:
        return subprocess.run([*ELSEWHERE, "true"], capture_output=True, timeout=100).returncode == 0
    except OSError:
        return False


class Process:
    """`kinegraph dev simulate lsl` with these settings, once it says that it is there; with another clock on a `host`, if one is named."""

    def __init__(self, host: str = "", **settings: Any) -> None:
        given = [f"{name}={value}" for name, value in settings.items()]
        command = [sys.executable, "-m", "kinegraph", "dev", "simulate", "lsl", *given, "--for", "60"]
        if host:
            command = [*ELSEWHERE, "sh", "-c", 'hostname "$0" && exec "$@"', host, *command]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self._process.stdout and self._process.stderr
        output = self._process.stdout.readline()
        assert output.startswith("LSL stream"), output + self._process.stderr.read()

    def kill(self) -> None:
        """As a crash or a power cut ends it."""
        self._process.kill()
        self._process.communicate()


@contextmanager
def process(host: str = "", **settings: Any) -> Iterator[Process]:
    """Within: the sender is there, unless it is killed."""
    sender = Process(host, **settings)
    try:
        yield sender
    finally:
        sender.kill()
