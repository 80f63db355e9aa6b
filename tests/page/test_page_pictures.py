"""Every shipped graph's page at 1280 x 800 and on a phone: its answer comes, nothing sticks out, and a picture is kept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from kinegraph.stream.graph.shipped import shipped
from tests.lab.test_lab_looks import axe as axe
from tests.lab.test_lab_looks import serious
from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

pytestmark = [pytest.mark.nightly, needs_page, needs_browser, pytest.mark.timeout(280)]

FAST = {"bedside_simulated": ["camera.bed_h=1"]}
"""A shorter night."""
BY_DAY = {"bedside_sleep", "bedside_two", "body_markers", "avatar", "avatar_oak", "webcam_avatar", "video_gait"}
"""What these wait for is not there within seconds: an epoch of sleep, a network that is not shipped, a step of somebody on the spot."""
NEEDS = {"webcam_avatar": "av"}
"""What else has to be installed."""
MAX_CONTROLS = 0.15
ANSWER = "document.querySelector('.answer')?.dataset.answer ?? ''"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser"), allowed="ERR_CONNECTION|WebSocket") as found:
        browser = found
        browser.ask("Page.setBypassCSP", enabled=True)  # of what the test itself puts in
        yield browser


@pytest.mark.parametrize("name", shipped())
def test_a_page_answers_first_on_a_screen_and_on_a_phone(
    browser: LiveBrowser, axe: str, name: str, tmp_path: Path
) -> None:
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    more = [part for one in FAST.get(name, ()) for part in ("--set", one)]
    arguments = ("run", name, "--simulate", "--view", "none", "--no-record", *more)
    with page_process(tmp_path, *arguments) as process:
        browser.open(process.url, 1280, 800)
        browser.wait("document.body.dataset.state === 'live'")
        if name not in BY_DAY:
            browser.wait(f"/^[^|]*[a-z1-9]/i.test({ANSWER})")
        first = "document.querySelector('#panels > section')"
        browser.wait(f"{first}?.classList.contains('answer')")
        assert browser.value("document.documentElement.scrollWidth <= innerWidth")
        browser.picture(tmp_path / f"graph-{name}.png")
        browser.size(390, 844)
        browser.wait("innerWidth === 390")
        assert browser.value("document.documentElement.scrollWidth <= innerWidth"), "nothing sticks out of a phone"
        tall = browser.value("document.querySelector('body > header').getBoundingClientRect().height")
        assert tall <= MAX_CONTROLS * 844, f"controls take {tall} of 844 pixels"
        browser.wait(f"{first}.getBoundingClientRect().width > 330")
        browser.picture(tmp_path / f"phone-{name}.png")
        assert serious(browser, axe) == []
        process.stop()


GRAPH = """
record: [chain]
nodes:
  board: {use: devices.people.treadmill.Treadmill, muscles: [TA, SO]}
  chain: {use: operators.emg.Envelope, from: board.emg}
"""
CATCH = "(make => { URL.createObjectURL = blob => { window.saved = blob; return make(blob); }; })(URL.createObjectURL.bind(URL))"


def saved(browser: LiveBrowser, panel: str, kind: str) -> str:
    """What a panel's button saves, as text; of a picture its first bytes."""
    browser.value("window.saved = null")
    browser.value(f"[...document.querySelectorAll('{panel} .save')].find(b => b.textContent === '{kind}').click()")
    browser.wait("!!window.saved")
    return str(browser.value("window.saved.text()"))


def test_what_a_panel_shows_is_saved_as_a_table_a_picture_or_a_drawing(browser: LiveBrowser, tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(GRAPH)
    with page_process(tmp_path, "run", "small.yaml", "--view", "none", "--no-record") as process:
        browser.open(process.url, 1280, 800)
        envelope = '[data-of="chain"]'
        browser.wait(f"document.querySelector('{envelope}')?.dataset.points > 100")
        browser.value(CATCH)
        title, heads, *rows = saved(browser, envelope, "CSV").splitlines()
        assert title == "# chain [µV]" and heads == "time_s,TA,SO" and len(rows) > 100
        assert [len(row.split(",")) for row in rows[:3]] == [3, 3, 3]
        assert saved(browser, envelope, "PNG")[1:4] == "PNG"
        drawing = saved(browser, ".panel.graph", "SVG")
        assert drawing.startswith("<svg") and ">board<" in drawing and "fill: " in drawing
        process.stop()
