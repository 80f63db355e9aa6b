"""`kinegraph demo`: each demo runs as its graph is, loses a second on purpose, opens the browser and leaves its report on the page."""

from __future__ import annotations

import os
import re
import signal
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.performer import Performer
from kinegraph.stream.cli.commands import demo as demos
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.reading.overrides import read
from kinegraph.stream.graph.shipped import shipped
from tests.support.browser import needs_browser
from tests.support.command_line import Command, refused
from tests.support.device_feed import Kept
from tests.support.live_browser import live_browser
from tests.support.page_session import a_terminal, needs_page, page_process


@pytest.fixture
def conducted(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """What a demo would run."""
    given: dict[str, Any] = {}
    monkeypatch.setattr(demos, "conduct", lambda graph, folder, **more: given.update(more, graph=graph, folder=folder))
    monkeypatch.setattr("os.environ", {**os.environ, "DISPLAY": ":0"})
    yield given


@pytest.mark.parametrize("name", demos.DEMOS)
def test_every_demo_is_a_shipped_graph_that_can_run(name: str) -> None:
    demo = demos.DEMOS[name]
    assert load(shipped()[demo.graph], overrides=read(list(demo.settings))).nodes


@needs_page
def test_it_opens_the_browser_at_the_page_and_loses_a_second(
    kinegraph: Command, conducted: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: bool(opened.append(url)) or True)
    code, _, output = kinegraph("demo")
    assert code == 0 and "lost on purpose" in output, output
    (fault,) = conducted["graph"].nodes["treadmill"].part.faults
    assert (fault.kind, fault.for_s) == ("lost", 1.0)
    assert conducted["duration_s"] == demos.UNATTENDED_S, "it cannot be ended by hand"
    assert conducted["simulate"] and any("kinegraph view recordings/" in line for line in conducted["farewell"])
    conducted["begun"]()
    assert opened == [conducted["pages"][0].address] and "token=" in opened[0]


@needs_page
def test_on_a_terminal_it_runs_until_ctrl_c_and_no_browser_is_opened_that_was_not_wanted(
    kinegraph: Command, conducted: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demos, "on_terminal", lambda: True)
    assert kinegraph("demo", "avatar", "--no-browser")[0] == 0
    assert conducted["duration_s"] == 0.0 and conducted["begun"] is None


def test_without_a_display_no_browser_of_text_takes_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.environ", {})
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr(webbrowser, "open", lambda _: pytest.fail("it is opened"))
    demos.show("http://127.0.0.1:7790/")


def test_a_browser_that_cannot_be_opened_is_no_fault(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.environ", {"DISPLAY": ":0"})
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    demos.show("http://127.0.0.1:7790/")
    assert "open http://127.0.0.1:7790/ in one" in capsys.readouterr().err


def test_a_demo_that_is_not_there_is_refused_with_the_nearest(kinegraph: Command) -> None:
    refused(kinegraph("demo", "treadmil"), "there is no demo 'treadmil'", "'treadmill'")


def test_frames_that_are_lost_on_purpose_are_counted() -> None:
    feed = Kept()
    Performer(realtime=False, duration_s=2.0, lost=(0.5, 1.0)).read(feed)
    whole = Kept()
    Performer(realtime=False, duration_s=2.0).read(whole)
    kept = feed.data("markers")
    assert len(kept) == 30 and feed.lost("markers") == {15: 30}
    np.testing.assert_array_equal(kept[15:], whole.data("markers")[45:])
    with pytest.raises(ParameterError, match="two numbers"):
        Performer(lost=(1.0,)).specs()


@pytest.mark.nightly
@needs_page
@needs_browser
@pytest.mark.timeout(500)
def test_a_person_watches_cycles_a_gap_and_finds_the_report_on_the_page(tmp_path: Path) -> None:
    with (
        a_terminal() as terminal,
        live_browser(tmp_path) as browser,
        page_process(tmp_path, "demo", "--no-browser", terminal=terminal) as process,
    ):
        browser.open(process.url)
        browser.wait("document.querySelector('.cycles')?.dataset.cycles > 2")
        assert browser.value("!!document.querySelector('input[aria-label=annotation]')")
        browser.wait("[...document.querySelectorAll('.signal')].some(panel => panel.dataset.gaps > 0)")
        process.process.send_signal(signal.SIGINT)
        browser.wait("document.querySelector('#status a')?.textContent === 'report'")
        assert not browser.value("!!document.querySelector('.signal .stale, .signal.stale')"), (
            "what is over is not late"
        )
        assert not browser.value("!!document.querySelector('input[aria-label=annotation]')"), (
            "it takes no marks any more"
        )
        assert browser.value("document.getElementById('status').textContent").startswith("the session has ended")
        assert browser.complaints == []
        assert re.search(r"kinegraph view recordings/treadmill_emg-\S+", process.output)
        assert process.stop() == 0
