"""`pytest -p tests.support.stop_in_time`: begin no other test after KINEGRAPH_STOP_S seconds of processor time; those that ran count."""

from __future__ import annotations

import os
import time

import pytest

LIMIT_S = float(os.environ.get("KINEGRAPH_STOP_S", "inf"))


@pytest.hookimpl(trylast=True)
def pytest_runtest_protocol(item: pytest.Item) -> None:
    """Asked before each test."""
    if time.process_time() > LIMIT_S:
        item.session.shouldstop = "the time is up"
