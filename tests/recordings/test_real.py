"""The real recordings of the repository are what their README says, and small."""

from __future__ import annotations

import hashlib
import re

from tests.support.real import REAL

HASHES = re.findall(r"^([0-9a-f]{64})  (\S+)$", (REAL / "README.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_every_recording_is_the_one_that_the_readme_names() -> None:
    files = {str(p.relative_to(REAL).as_posix()): p for p in REAL.rglob("*") if p.is_file() and p.name != "README.md"}
    assert {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()} == {
        n: h for h, n in HASHES
    }
    assert len(files) >= 8


def test_they_stay_small() -> None:
    sizes = [path.stat().st_size for path in REAL.rglob("*") if path.is_file()]
    assert max(sizes) <= 400_000 and sum(sizes) <= 3_000_000
