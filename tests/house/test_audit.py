"""`make audit` where an index cannot be asked, or does not know a package: it audits the rest, and fails."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).resolve().parents[2]
INDEX = """
import json, requests
KNOWN = {answers!r}
def send(self, request, **_):
    response = requests.Response()
    response.request, response.url = request, request.url
    name = request.url.split("/pypi/")[1].split("/")[0]
    response.status_code = 200 if name in KNOWN else 404
    response._content = json.dumps({{"vulnerabilities": KNOWN.get(name)}}).encode()
    return response
requests.Session.send = send
"""
HOLE = {
    "id": "PYSEC-2099-1",
    "aliases": [],
    "summary": "a hole",
    "fixed_in": ["2.1.0"],
    "published": "2099-01-01T00:00:00Z",
}


def audit(tmp_path: Path, *packages: str, **environment: str) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("pip_audit", reason="`make audit` installs it")
    wanted = tmp_path / "wanted.txt"
    wanted.write_text("\n".join(packages) + "\n", encoding="utf-8")
    return subprocess.run(
        [sys.executable, "-m", "tests.audit", str(wanted)],
        cwd=ROOT,
        env={**os.environ, "PIP_CACHE_DIR": str(tmp_path / "cache"), **environment},
        capture_output=True,
        text=True,
        timeout=200,
    )


def test_an_audit_that_cannot_ask_fails(tmp_path: Path) -> None:
    with socket.socket() as absent:
        absent.bind(("127.0.0.1", 0))
        away = f"http://127.0.0.1:{absent.getsockname()[1]}"
        done = audit(tmp_path, "numpy==2.0.0", HTTPS_PROXY=away, HTTP_PROXY=away, https_proxy=away, http_proxy=away)
    assert done.returncode != 0 and "could not be made" in done.stderr, done.stderr
    assert "No known" not in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("answers", "expected", "code"),
    [
        ({"numpy": [], "bvh": [], "rich": []}, ["3 of 3 packages audited; known holes: 0"], 0),
        ({"numpy": [], "rich": []}, ["2 of 3 packages audited; known holes: 0", "knows nothing of 1: bvh"], 1),
        ({"rich": [HOLE]}, ["rich 1.0: PYSEC-2099-1, mended in 2.1.0", "1 of 3", "knows nothing of 2: numpy, bvh"], 1),
        ({}, ["0 of 3 packages audited", "answers about no package"], 1),
        ({"numpy": [], "bvh": [], "rich": [HOLE]}, ["3 of 3 packages audited; known holes: 1"], 1),
    ],
)  # fmt: skip
def test_a_package_that_the_index_does_not_know(
    answers: dict[str, list[object]], expected: list[str], code: int, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(INDEX.format(answers=answers), encoding="utf-8")
    done = audit(tmp_path, "numpy==2.0.0", "bvh==0.3", "rich==1.0", PYTHONPATH=str(tmp_path))
    assert done.returncode == code, done.stderr
    assert [words for words in expected if words not in done.stdout] == []
