"""What a recording was made with: bits are promised on the same versions and the same processor family."""

from __future__ import annotations

import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version


def versions() -> dict[str, str]:
    """The versions of everything that can change a bit of an output."""
    found = {"python": platform.python_version(), "platform": sys.platform, "processor": processor()}
    for package in ("kinegraph", "numpy", "numba", "llvmlite", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = ""
    return found


@cache
def release() -> str:
    """The version of kinegraph."""
    try:
        return version("kinegraph")
    except PackageNotFoundError:
        return ""


def processor() -> str:
    """The processor's family, for people: its model name where the system tells it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:  # noqa: PTH123
            names = (line.partition(":")[2].strip() for line in file if line.startswith("model name"))
            return f"{platform.machine()} {next(names, '')}".strip()
    except OSError:
        return f"{platform.machine()} {platform.processor()}".strip()
