"""Sessions of a lab outlive it by design; those of a test that fails must not outlive the test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from kinegraph.devices.lab.sessions import FACTS, LabSession


@pytest.fixture(autouse=True)
def ended(tmp_path: Path) -> Iterator[None]:
    yield
    for facts in tmp_path.rglob(FACTS):
        LabSession(facts.parent).stop()
