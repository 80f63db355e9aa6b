"""The lab in a real browser, by clicks: a treadmill session from an empty folder to its report, and what no lab may lose."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kinegraph.stream.recording import Recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH, wait_for
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page

pytestmark = [pytest.mark.nightly, needs_page, needs_browser, pytest.mark.timeout(280)]

PAGE = "document.querySelector('iframe.page')?.contentDocument"
UNSEEN = """# A use that nobody has seen.
settings:
  smooth: {label: Low-pass, unit: Hz, min: 1, max: 40, feeds: chain.cutoff_hz}
  method: {label: Method, choices: [fast, slow], default: fast}
  careful: {label: Careful, type: boolean, default: false}
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  chain: {use: operators.emg.Envelope, from: board.emg}
record: [chain]
"""


@contextmanager
def lab(home: Path, port: int = 0) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """`kinegraph lab`, and its address; it is gone afterwards, sessions are not."""
    log = home.parent / "lab.txt"
    with (
        log.open("wb") as out,
        subprocess.Popen(
            [KINEGRAPH, "lab", home, "--no-browser", "--at", f":{port}"], stderr=out, stdout=out
        ) as process,
    ):
        try:
            wait_for(lambda: "lab: " in log.read_text())
            yield process, re.findall(r"http\S+", log.read_text())[0]
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(20)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    # while a lab is gone, its page asks in vain, and a session that ends takes its page with it
    with live_browser(tmp_path_factory.mktemp("browser"), allowed="ERR_CONNECTION|WebSocket|status of 40") as found:
        yield found


def click(browser: LiveBrowser, text: str) -> None:
    """Click the visible button, link or summary with this text."""
    begins = f"e.innerText.trim().startsWith({json.dumps(text)}) && e.offsetParent"
    script = f"[...document.querySelectorAll('button, a, summary')].find(e => {begins})"
    browser.wait(f"!!{script}")
    browser.value(f"{script}.click()")


def fill(browser: LiveBrowser, label: str, value: str) -> None:
    browser.wait(f"[...document.querySelectorAll('label')].some(l => l.innerText.startsWith({json.dumps(label)}))")
    browser.value(
        f"(l => {{ const f = document.getElementById(l.htmlFor); f.value = {json.dumps(value)};"
        "f.dispatchEvent(new Event('input', {bubbles: true})); })"
        f"([...document.querySelectorAll('label')].find(l => l.innerText.startsWith({json.dumps(label)})))"
    )


def stop(browser: LiveBrowser) -> None:
    click(browser, "Stop")
    click(browser, "End the session")
    browser.wait("!!document.querySelector('.finished')")


def session_of(home: Path) -> Path:
    return next((home / "sessions").iterdir())


def test_a_treadmill_session_by_clicks_from_an_empty_folder_to_the_report(browser: LiveBrowser, tmp_path: Path) -> None:
    home = tmp_path / "home"
    with lab(home) as (_, url):
        browser.open(url, 1280, 800)
        click(browser, "Treadmill, both legs")
        fill(browser, "Subject", "P07")
        click(browser, "Start")
        browser.wait("!!document.querySelector('iframe.page')")
        browser.wait(f"/^[1-9]/.test({PAGE}?.querySelector('.answer')?.dataset.answer ?? '')")
        assert "steps/min" in browser.value(f"{PAGE}?.querySelector('.answer').innerText")
        browser.picture(tmp_path / "lab-run.png")
        browser.value("document.querySelector('.marking input').value = 'stumbled'")
        click(browser, "Mark")
        browser.wait("document.querySelector('.bar output').innerText === 'marked: stumbled'")
        stop(browser)
        browser.wait("!!document.querySelector('iframe.report') && !!document.querySelector('.answerline')")
        assert "cycles" in browser.value("document.querySelector('.answerline').innerText")
        browser.picture(tmp_path / "lab-finish.png")
        click(browser, "PDF")
        browser.wait("document.querySelector('.finished').innerText.includes('saved')")
        assert next(session_of(home).rglob("*.pdf")).read_bytes().startswith(b"%PDF")
        with Recording.open(session_of(home)) as recording:
            assert recording.header["session"]["subject"] == "P07" and not recording.missing
            assert "stumbled" in recording.read("annotations")[1]["text"].tolist()
        click(browser, "Library")
        browser.wait("(document.querySelector('tbody')?.innerText ?? '').includes('P07')")


def test_a_killed_lab_loses_nothing_and_the_next_one_finds_the_session(browser: LiveBrowser, tmp_path: Path) -> None:
    home = tmp_path / "home"
    with lab(home) as (process, url):
        browser.open(url, 1280, 800)
        click(browser, "Treadmill, one leg")
        click(browser, "Start")
        browser.wait(f"/^[1-9]/.test({PAGE}?.querySelector('.answer')?.dataset.answer ?? '')")
        process.kill()
        browser.wait("document.querySelector('.bar output').innerText.includes('sessions go on')")
    with lab(home) as (_, url):
        browser.open(url, 1280, 800)
        browser.wait("!!document.querySelector('.sessions .live')")
        browser.value("document.querySelector('.sessions a').click()")
        browser.wait(f"/^[1-9]/.test({PAGE}?.querySelector('.answer')?.dataset.answer ?? '')")
        stop(browser)
    with Recording.open(session_of(home)) as recording:
        assert not recording.missing and not [s for s in recording.streams.values() if s.gaps]


def test_a_graph_never_seen_gets_a_usable_form(browser: LiveBrowser, tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "graphs").mkdir(parents=True)
    (home / "graphs" / "unseen.yaml").write_text(UNSEEN)
    with lab(home) as (_, url):
        browser.open(url, 1280, 800)
        click(browser, "unseen")
        fill(browser, "Low-pass", "12")
        assert browser.value("[...document.querySelectorAll('.setup select option')].map(o => o.value)") == [
            "fast",
            "slow",
        ]
        assert browser.value("document.querySelectorAll('.setup input[type=checkbox]').length") == 1
        click(browser, "Start")
        browser.wait("!!document.querySelector('iframe.page')")
        wait_for(lambda: any((home / "sessions").rglob("*.mcap")))
        stop(browser)
        with Recording.open(session_of(home)) as recording:
            assert "cutoff_hz: 12" in str(recording.header["graph"])
