"""Every dependency of the bedside monitor has a wheel for a 64-bit Raspberry Pi: nothing is compiled there."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
TAGS = (*tuple(f"manylinux_2_{minor}_aarch64" for minor in range(36, 16, -1)), "manylinux2014_aarch64", "linux_aarch64")
"""What Raspberry Pi OS 12 takes: glibc 2.36, Python 3.11."""
UNREACHABLE = (
    "Retrying",
    "NewConnectionError",
    "Temporary failure",
    "No route to host",
    "Read timed out",
    "no such option",
)
COMPILED = {"numpy", "scipy", "numba", "llvmlite", "msgspec", "lz4", "zstandard", "matplotlib", "depthai"}


def needed() -> list[str]:
    """What `pip install kinegraph[oak]` asks for there; pip itself judges markers by the machine that it runs on."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *project["optional-dependencies"]["oak"]]
    return [one for one in lines if "platform_machine != 'aarch64'" not in one]


@pytest.mark.timeout(240)
def test_a_raspberry_pi_compiles_nothing(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--ignore-installed",
        "--quiet",
        "--only-binary",
        ":all:",
    ]
    command += ["--target", str(tmp_path), "--python-version", "3.11", "--implementation", "cp", "--retries", "1"]
    command += [word for tag in TAGS for word in ("--platform", tag)]
    try:
        done = subprocess.run([*command, "--report", "-", *needed()], capture_output=True, text=True, timeout=200)
    except subprocess.TimeoutExpired:
        pytest.skip("the package index did not answer within 200 s")
    if done.returncode and any(word in done.stderr for word in UNREACHABLE):
        pytest.skip("the package index cannot be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    files = [one["download_info"]["url"].rpartition("/")[2] for one in json.loads(done.stdout)["install"]]
    assert files and all(name.endswith(("-any.whl", "aarch64.whl")) for name in files), files
    natively = {name.partition("-")[0] for name in files if name.endswith("aarch64.whl")}
    assert natively >= COMPILED, "a wheel that ought to hold machine code does not"
