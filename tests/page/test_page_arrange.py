"""An arrangement made on the page, written as the section `page:`, gives the same page."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph.devices.page.transfer.catalogue import hello
from kinegraph.stream.graph.reading.load import load_text
from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

pytestmark = [pytest.mark.nightly, needs_page, needs_browser, pytest.mark.timeout(280)]

NODES = """nodes:
  board: {use: devices.people.treadmill.Treadmill}
  calf: {use: operators.filters.channels.Select, from: board.emg, channels: [GM, SO]}
  active: {use: operators.filters.threshold.Threshold, from: calf, channel: GM, level: 40, release: 25}
"""
GRAPH = """page:
  panels:
    - {kind: signal, of: calf, title: 'a "calf": {x}', most: 200, least: -200}
    - {kind: events, of: [active.interval, annotations]}
    - {kind: signal, of: board.emg}
    - {kind: state}
"""


def press(browser: LiveBrowser, panel: int, what: str, times: int = 1) -> None:
    """Press a handle of the panel that stands there now."""
    for _ in range(times):
        browser.value(
            f"document.querySelectorAll('.panel')[{panel}].querySelector('.handles [aria-label={what}]').click()"
        )


def test_an_arrangement_can_be_put_into_the_graph(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH + NODES)
    with (
        page_process(tmp_path, "run", "g.yaml", "--view", "none", "--no-record") as process,
        live_browser(tmp_path) as browser,
    ):
        browser.open(process.url)
        browser.wait(
            "document.querySelectorAll('.panel').length === 4 && document.querySelector('.signal').dataset.points > 10"
        )
        browser.value("document.querySelector('select[aria-label=\"seconds shown\"]').value = '30'")
        browser.value(
            "document.querySelector('select[aria-label=\"seconds shown\"]').dispatchEvent(new Event('change'))"
        )
        browser.value(
            "[...document.querySelectorAll('#controls button')].find(b => b.textContent === 'arrange').click()"
        )
        for place in (3, 2, 1):  # the engine first
            press(browser, place, "earlier")
        press(browser, 0, "wider")
        press(browser, 1, "taller", 2)
        press(browser, 3, "remove")
        written = browser.value("document.querySelector('.arrangement textarea').value")
        browser.value("document.querySelector('.arrangement button').focus()")
        browser.type(" ")
        browser.wait("document.querySelector('.arrangement button').textContent === 'copied'")
        browser.wait(
            "document.querySelectorAll('.panel').length === 3 && document.querySelector('.state').dataset.rows > 0"
        )
        assert browser.value("document.querySelector('.state').classList.contains('wide2')")
        browser.wait(
            "document.querySelectorAll('.panel')[1].querySelector('canvas')?.getBoundingClientRect().height > 450"
        )
        assert browser.complaints == []
    reported = hello(load_text(written + NODES), outside=False, mode="live", t0_ns=0)["panels"]
    assert [(p["kind"], p["of"]) for p in reported] == [
        ("state", []),
        ("signal", ["calf"]),
        ("events", ["active.interval", "annotations"]),
    ]
    assert reported[0]["wide"] == 2
    assert {k: reported[1][k] for k in ("title", "least", "most", "tall", "window_s")} == {
        "title": 'a "calf": {x}', "least": -200, "most": 200, "tall": 2, "window_s": 30,
    }  # fmt: skip
    looks_so(tmp_path, written)


def looks_so(folder: Path, section: str) -> None:
    """The page of a session with this section."""
    (folder / "again.yaml").write_text(section + NODES)
    with (
        page_process(folder, "run", "again.yaml", "--view", "none", "--no-record") as process,
        live_browser(folder) as browser,
    ):
        browser.open(process.url)
        browser.wait("document.querySelector('.signal')?.dataset.points > 10")
        panels = browser.value(
            "[...document.querySelectorAll('.panel')].map(p => [p.className.match(/panel (\\w+) (\\w+)/).slice(1).join(' '), p.dataset.of])"
        )
        assert panels == [
            ["state wide2", ""],
            ["signal wide1", "calf"],
            ["events wide1", "active.interval annotations"],
        ]
        assert browser.value("document.querySelector('.signal canvas').getBoundingClientRect().height") > 450
        assert browser.value("document.querySelector('select[aria-label=\"seconds shown\"]').value") == "30"
        assert browser.complaints == []
