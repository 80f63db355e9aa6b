"""`make audit` where nobody can be asked: it fails, and does not say that nothing is known."""

from __future__ import annotations

import os
import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest

MAKEFILE = Path(__file__).resolve().parents[2] / "Makefile"


def test_an_audit_that_cannot_ask_fails(tmp_path: Path) -> None:
    pytest.importorskip("pip_audit", reason="`make audit` installs it")
    wanted = tmp_path / "wanted.txt"
    wanted.write_text("numpy==2.0.0\n", encoding="utf-8")
    (line,) = (line for line in MAKEFILE.read_text(encoding="utf-8").splitlines() if "-m pip_audit" in line)
    words = shlex.split(line.partition("-m pip_audit")[2].replace("$$wanted", str(wanted)))
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        away = f"http://127.0.0.1:{nobody.getsockname()[1]}"
        done = subprocess.run(
            [sys.executable, "-m", "pip_audit", *words],
            env={**os.environ, "HTTPS_PROXY": away, "HTTP_PROXY": away, "https_proxy": away, "http_proxy": away},
            capture_output=True,
            text=True,
            timeout=200,
        )
    assert done.returncode != 0 and "No known vulnerabilities" not in done.stdout + done.stderr, done.stderr
