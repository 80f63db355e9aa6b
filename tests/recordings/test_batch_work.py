"""The recorder's thread does not interrupt the session's: when the scheduler treats it as batch work, and when not."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder
from kinegraph.stream.system.stalls import let_others_go_on

pytestmark = pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="only Linux can be told so")


def in_a_thread(*steps: Callable[[], None]) -> int:
    """What the scheduler knows of a thread after these steps."""
    found: list[int] = []

    def run() -> None:
        for step in steps:
            step()
        found.append(os.sched_getscheduler(0))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return found[0]


def test_the_recorder_is_batch_work_and_the_thread_that_makes_it_is_not(tmp_path: Path) -> None:
    before = os.sched_getscheduler(0)
    with Recorder(tmp_path / "session", {"graph": ""}, RecordingOptions()):
        found = {t.name: os.sched_getscheduler(t.native_id or 0) for t in threading.enumerate()}
        assert os.sched_getscheduler(0) == before
    assert found["recorder"] == (os.SCHED_BATCH if before == os.SCHED_OTHER else before)


def test_whoever_chose_another_way_keeps_it() -> None:
    idle = lambda: os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))  # noqa: E731
    assert in_a_thread(idle, let_others_go_on) == os.SCHED_IDLE


def test_a_system_that_refuses_leaves_the_thread_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert in_a_thread(let_others_go_on) == os.sched_getscheduler(0)
