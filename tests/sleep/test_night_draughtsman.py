"""A report that cannot be drawn: tried again a few times, reported twice, and once more when the session ends."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from kinegraph.devices.reports.night import renderer
from kinegraph.devices.reports.night.renderer import ReportRenderer
from kinegraph.stream.errors import DeviceError


class Failing:
    """A process that has ended at once, with a complaint; or without, once `well`."""

    started = 0
    well = False
    pid = 0

    def __init__(self, *_: Any, **__: Any) -> None:
        Failing.started += 1
        self.returncode = 0 if Failing.well else 2
        self.stderr = io.BytesIO(b"no such font\n")

    def poll(self) -> int:
        return self.returncode

    def wait(self, _: float) -> int:
        return self.returncode


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds, to be set; processes that fail."""
    now = [0.0]
    monkeypatch.setattr(renderer.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(renderer.subprocess, "Popen", Failing)
    monkeypatch.setattr(renderer, "yield_processor", lambda _: None)
    Failing.started, Failing.well = 0, False
    return now


def look_for(hours: float, works: ReportRenderer, clock: list[float]) -> list[str]:
    """What is logged while it looks once in ten seconds."""
    with capture_logs() as logs:
        for _ in range(round(hours * 360)):
            clock[0] += 10.0
            works.look()
    return [str(line["event"]) for line in logs]


def test_a_failing_report_is_tried_a_few_times_and_told_twice(tmp_path: Path, clock: list[float]) -> None:
    works = ReportRenderer()
    works.soon(tmp_path)
    warned = look_for(24, works, clock)
    assert Failing.started == 1 + len(renderer.AGAIN_S)
    assert warned == ["report incomplete; it is tried again a few times", "report postponed until the session ends"]
    with pytest.raises(DeviceError, match=r"no such font.*kinegraph sleep nights report"):
        works.finish()
    assert Failing.started == 2 + len(renderer.AGAIN_S), "once more at the end"


def test_a_report_that_was_given_up_is_drawn_when_its_night_changes_or_the_session_ends(
    tmp_path: Path, clock: list[float]
) -> None:
    works = ReportRenderer()
    works.soon(tmp_path)
    look_for(24, works, clock)
    Failing.well = True
    works.soon(tmp_path)
    assert look_for(1, works, clock) == ["report written"]
    works.finish()
    assert Failing.started == 2 + len(renderer.AGAIN_S)
