"""`pytest -p tests.support.stop_in_time`: begin no other test after KINEGRAPH_STOP_S seconds of processor time, its own and that of
processes that ended; those that ran count."""

from __future__ import annotations

import os

import pytest

LIMIT_S = float(os.environ.get("KINEGRAPH_STOP_S", "inf"))


@pytest.hookimpl(trylast=True)
def pytest_runtest_protocol(item: pytest.Item) -> None:
    """Asked before each test."""
    if sum(os.times()[:4]) > LIMIT_S:
        item.session.shouldstop = "the time is up"
