"""The lab in a real browser, by clicks: each use from an empty folder to its answer and its report, and what no lab may lose."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kinegraph.devices.lab.sessions import LabSession, Sessions
from kinegraph.stream.recording import Recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH, wait_for
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page

pytestmark = [pytest.mark.nightly, needs_page, needs_browser, pytest.mark.timeout(280)]

MAX_CLICKS = 8
"""From an empty lab to the first live answer of a simulated device."""
PAGE = "document.querySelector('iframe.page')?.contentDocument"
UNSEEN = """# A use that is new.
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
            process.wait(100)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    # while a lab is gone, its page asks in vain, and a session that ends takes its page with it
    with live_browser(tmp_path_factory.mktemp("browser"), allowed="ERR_CONNECTION|WebSocket|status of 40") as found:
        yield found


def click(browser: LiveBrowser, text: str) -> int:
    """Click the visible button, link or summary with this text, as a mouse does; 1: so many clicks it took."""
    begins = f"e.innerText.trim().startsWith({json.dumps(text)}) && e.offsetParent"
    script = f"[...document.querySelectorAll('button, a, summary')].find(e => {begins} && !e.disabled)"
    browser.wait(f"!!{script}")
    x, y = browser.value(
        f"(e => {{ e.scrollIntoView({{block: 'center'}}); const r = e.getBoundingClientRect();"
        f"return [r.x + r.width / 2, r.y + r.height / 2]; }})({script})"
    )
    for kind in ("mousePressed", "mouseReleased"):
        browser.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    return 1


def choose(browser: LiveBrowser, select: str, number: int) -> None:
    browser.value(
        f"(s => {{ s.value = s.options[{number}].value; s.dispatchEvent(new Event('change', {{bubbles: true}})); }})"
        f"(document.querySelector('{select}'))"
    )


def answered(browser: LiveBrowser, pattern: str = "^[1-9]") -> str:
    """The answer, once it looks like that."""
    answer = f"({PAGE}?.querySelector('.answer')?.dataset.answer ?? '')"
    return str(browser.wait(f"/{pattern}/.test({answer}) && {answer}"))


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


def test_a_fallen_electrode_is_noticed_taped_again_and_the_session_compared(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    home = tmp_path / "home"
    with lab(home) as (_, url):
        earlier = {"session.subject": "P07", "treadmill.realtime": False, "treadmill.duration_s": 40}
        browser.open(url, 1280, 800)
        clicks = click(browser, "Treadmill, both legs")
        fill(browser, "Subject", "P07")
        choose(browser, "#rehearsal", 1)
        clicks += click(browser, "Start")
        browser.picture(tmp_path / "lab-waits.png")
        assert "steps/min" in answered(browser) and clicks <= MAX_CLICKS
        Sessions(home).run("treadmill_both_legs", "treadmill_both_legs", earlier, simulate=False)
        alarms = f"{PAGE}.querySelector('.alarms').innerText"
        browser.wait(f"{alarms}.includes('L_RF: flat line') && {alarms}.includes('press it on')")
        browser.picture(tmp_path / "lab-alarm.png")
        browser.wait(f"{PAGE}.querySelector('.answer').dataset.alarms === '0'")
        browser.value("document.querySelector('.marking input').value = 'taped again'")
        click(browser, "Mark")
        browser.wait("document.querySelector('.bar output').innerText === 'marked: taped again'")
        click(browser, "Pause stage")
        click(browser, "Resume stage")
        browser.wait("document.querySelector('.bar output').innerText === 'marked: resume stage'")
        browser.picture(tmp_path / "lab-run.png")
        stop(browser)
        browser.wait("!!document.querySelector('iframe.report') && !!document.querySelector('.answerline')")
        assert "cycles" in browser.value("document.querySelector('.answerline').innerText")
        browser.picture(tmp_path / "lab-finish.png")
        click(browser, "PDF")
        browser.wait("document.querySelector('.finished').innerText.includes('saved')")
        mine = browser.value("decodeURIComponent(location.hash.split('/').pop())")
        folder = home / "sessions" / mine
        assert next(folder.rglob("*.pdf")).read_bytes().startswith(b"%PDF")
        with Recording.open(folder) as recording:
            assert recording.header["session"]["subject"] == "P07" and not recording.missing
            notes = recording.read("annotations")[1]["text"].tolist()
            assert notes == ["taped again", "pause stage", "resume stage"]
            assert {"", "warm-up"} <= set(recording.read("stages.closed")[1]["stage"].tolist())
        other = next(path for path in (home / "sessions").iterdir() if path != folder)
        wait_for(lambda: not LabSession(other).runs)
        click(browser, "Home")
        browser.wait("document.querySelectorAll('.sessions .result').length === 2")
        browser.value(f"location.hash = '#/session/{mine}'")
        click(browser, "Compare")
        browser.wait("document.querySelector('iframe.report').src.includes('comparison')")
        assert "Mean curves" in next(folder.rglob("comparison.html")).read_text(encoding="utf-8")
        browser.picture(tmp_path / "lab-compared.png")
        click(browser, "Library")
        browser.wait("(document.querySelector('tbody')?.innerText ?? '').includes('P07')")
        browser.picture(tmp_path / "lab-library.png")


def test_a_bed_is_drawn_and_its_night_begun_in_the_evening_is_read_in_the_morning(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    home = tmp_path / "home"
    with lab(home) as (_, url):
        browser.open(url, 1280, 800)
        clicks = click(browser, "Night, simulated") + click(browser, "Draw the bed") + click(browser, "Draw a frame")
        label = "document.querySelector('.region')?.getAttribute('aria-label') ?? ''"
        assert browser.wait(f"({label}).includes('rows 24 to 96, columns 40 to 120')")
        x, y, wide = browser.value(
            "(e => { e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2, document.querySelector('.camera canvas').clientWidth]; })"
            "(document.querySelector('.region'))"
        )
        for kind, right in (("mousePressed", 0), ("mouseMoved", wide / 10), ("mouseReleased", wide / 10)):
            more = {"button": "left", "buttons": 1, "clickCount": 1}
            browser.ask("Input.dispatchMouseEvent", type=kind, x=x + right, y=y, **more)
        assert browser.wait(f"({label}).includes('columns 56 to 136')"), "a tenth of 160 columns further"
        browser.value("document.querySelector('.region').focus()")
        browser.press("ArrowDown", shift=True)
        assert browser.wait(f"({label}).includes('rows 24 to 104')")
        assert browser.colours(".camera canvas") > 20
        browser.picture(tmp_path / "lab-bed.png")
        clicks += 1 + click(browser, "Close the camera")
        assert {path.suffix for path in home.rglob("*") if path.is_file()} == {".yaml"}, "no picture is kept"
        fill(browser, "Time in bed", "1.2")
        clicks += click(browser, "Start")
        assert answered(browser, "in bed|out of bed") and clicks <= MAX_CLICKS
        browser.picture(tmp_path / "lab-night.png")
        assert LabSession(session_of(home)).facts["values"]["bedside.regions"] == [[24, 56, 80, 80]]
        browser.wait("!!document.querySelector('.answerline')")  # in the morning it ends by itself
        assert browser.value("document.querySelector('.answerline').innerText").startswith("Asleep ")
        browser.wait("!!document.querySelector('iframe.report')")
        browser.picture(tmp_path / "lab-morning.png")


def test_an_avatar_runs(browser: LiveBrowser, tmp_path: Path) -> None:
    with lab(tmp_path / "home") as (_, url):
        browser.open(url, 1280, 800)
        clicks = click(browser, "Avatar, with markers") + click(browser, "Start")
        assert answered(browser, "it follows you") and clicks <= MAX_CLICKS
        browser.wait(f"{PAGE}.querySelector('.avatar canvas')?.width > 100")
        browser.picture(tmp_path / "lab-avatar.png")
        stop(browser)


def test_squats_are_counted_and_a_lab_that_is_killed_loses_nothing(browser: LiveBrowser, tmp_path: Path) -> None:
    home = tmp_path / "home"
    with lab(home) as (process, url):
        browser.open(url, 1280, 800)
        clicks = click(browser, "Repetitions, whole body")
        clicks += sum(click(browser, "\u2212") for _ in range(3))
        fill(browser, "Exercises", "squat")
        clicks += click(browser, "Start")
        assert answered(browser, "^[1-9]") and clicks <= MAX_CLICKS
        click(browser, "More")
        browser.value("document.querySelector('.menu input').focus()")
        browser.type("squat\r")
        answered(browser, "squat")
        process.kill()
        browser.wait("document.querySelector('.bar output').innerText.includes('sessions go on')")
    with lab(home) as (_, url):
        browser.open(url, 1280, 800)
        browser.wait("!!document.querySelector('.sessions .live')")
        browser.value("document.querySelector('.sessions a').click()")
        answered(browser, "[1-9].*squat")
        browser.picture(tmp_path / "lab-squats.png")
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
        assert browser.value(
            "[...document.querySelectorAll('.setup select:not(#rehearsal) option')].map(o => o.value)"
        ) == [
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
