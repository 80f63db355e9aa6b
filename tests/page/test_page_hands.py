"""The page by hand: every function by keyboard, measuring between two cursors, one scale for all, a held picture, gaps, silence."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from kinegraph.stream.chunk import NS, StreamSpec, grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.page.test_page import SMALL
from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process, until
from tests.support.tiers import rest_nightly

pytestmark = [needs_page, needs_browser, pytest.mark.timeout(280)]

RATE_HZ, SECONDS, GAP = 200.0, 40, (20, 22)
TWO = StreamSpec((2,), rate_hz=RATE_HZ, channels=("ramp", "small"), units=("uV",))
SHADES = ("#1f5fa8", "#b0481c")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture(scope="module")
def ramp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A value that is its time in s, and a tiny one; two seconds are missing, and the ramp goes on behind them."""
    place = tmp_path_factory.mktemp("ramp") / "ramp.mcap"
    time = grid(RATE_HZ, round(SECONDS * RATE_HZ))
    second = (time - time[0]) / NS
    data = np.column_stack([second, 0.01 * np.sin(40 * second)])
    kept = (second < GAP[0]) | (second >= GAP[1])
    write_recording(place, [Series("ramp", TWO, time[kept] + 1_700_000_000 * NS, data[kept])], {})
    return place


@pytest.fixture
def view(ramp: Path, browser: LiveBrowser, tmp_path: Path) -> Iterator[LiveBrowser]:
    """The ramp, looked at from 10 s to 20 s."""
    with page_process(tmp_path, "view", ramp) as process:
        browser.open(process.url)
        browser.value("document.documentElement.dataset.theme = 'light'")
        shown(browser, 10, 15)
        yield browser
    assert browser.complaints == []


def shown(browser: LiveBrowser, window_s: int, at: int) -> None:
    """So much, around a moment that is a whole number of steps from the beginning."""
    browser.wait("document.body.dataset.looked >= 0 && document.querySelector('.signal')?.dataset.points > 0")
    browser.value(
        f"(s => {{ s.value = '{window_s}'; s.dispatchEvent(new Event('change')); }})"
        "(document.querySelector('select[aria-label=\"seconds shown\"]'))"
    )
    browser.value("document.activeElement.blur()")
    browser.press("Home")
    browser.wait("+document.body.dataset.looked === 0")
    browser.press("ArrowRight", round(10 * at / window_s))
    browser.wait(f"Math.abs(document.body.dataset.looked - {at}) < .001")


def note(browser: LiveBrowser) -> str:
    return str(browser.value("document.querySelector('.signal output').textContent"))


def measured(text: str) -> tuple[float, float, float]:
    """The duration (s) and the ramp's range that a chart says."""
    found = re.fullmatch(r"(\d+) ms: ramp ([\d.]+) to ([\d.]+); small \S+ to \S+", text)
    assert found, text
    return int(found[1]) / 1000, float(found[2]), float(found[3])


def test_two_cursors_measure_by_mouse_and_by_keys(view: LiveBrowser) -> None:
    view.drag(".signal .u-over", 0.2, 0.7)
    view.wait("document.querySelector('.signal output').textContent.includes(' ms: ')")
    seconds, low, high = measured(note(view))
    assert abs(seconds - 5) < 0.1 and abs(low - 12) < 0.1 and abs(high - 17) < 0.1
    view.value("document.querySelector('.signal').focus()")
    view.press("Escape")
    view.wait("document.querySelector('.signal output').textContent === ''")
    view.press("ArrowRight", 10, shift=True)  # a fiftieth of what is shown each
    seconds, low, high = measured(note(view))
    assert abs(seconds - 2) < 0.1 and abs(low - 15) < 0.1 and abs(high - 17) < 0.1
    view.press("ArrowUp", 5, shift=True)
    view.press("ArrowLeft", 5, shift=True)
    seconds, low, high = measured(note(view))
    assert abs(seconds - 1) < 0.1 and abs(low - 16) < 0.1 and abs(high - 17) < 0.1
    assert abs(view.value("+document.body.dataset.looked") - 15) < 0.001, "the cursor of the recording stays"


def test_each_channel_has_its_scale_or_all_have_one(view: LiveBrowser) -> None:
    def height(shade: str) -> int:
        return int(np.ptp(np.array(view.like(".signal canvas", shade, within=60))[:, 1]))

    lane = view.value("document.querySelector('.signal .u-over').clientHeight") / 2
    view.wait("document.querySelector('.signal').dataset.points > 100")
    assert height(SHADES[0]) > 0.6 * lane and height(SHADES[1]) > 0.6 * lane
    drawn = view.value("+document.body.dataset.drawn")
    view.value("[...document.querySelectorAll('.signal button')].find(b => b.textContent === 'one scale').click()")
    view.wait(f"document.body.dataset.drawn > {drawn} + 2")
    assert height(SHADES[0]) > 0.6 * lane and height(SHADES[1]) < 0.1 * lane


@pytest.mark.parametrize("window_s", rest_nightly(60, 10))
def test_a_gap_is_left_empty_from_close_by_and_from_afar(view: LiveBrowser, window_s: int) -> None:
    """The ramp would be drawn through the gap if anything joined what is before it and behind it."""
    shown(view, window_s, 21 if window_s == 10 else 24)
    view.wait("document.querySelector('.signal').dataset.gaps === '1'")
    begin = (21 if window_s == 10 else 24) - window_s / 2
    left, width = view.value("(o => [o.offsetLeft, o.clientWidth])(document.querySelector('.signal .u-over'))")
    columns = np.unique(np.array(view.like(".signal canvas", SHADES[0], within=60))[:, 0])
    at = begin + (columns - left) / width * window_s
    pixel_s = window_s / width
    assert not ((at > GAP[0] + 4 * pixel_s) & (at < GAP[1] - 4 * pixel_s)).any(), "the gap was joined"
    for before, behind in ((max(begin, 0) + 0.5, GAP[0] - 0.5), (GAP[1] + 0.5, min(begin + window_s, SECONDS) - 0.5)):
        there = ((at > before) & (at < behind)).sum()
        assert there > 0.9 * (behind - before) / pixel_s, "the line lacks pieces elsewhere"


def test_what_is_painted_reaches_from_the_least_to_the_greatest_of_each_column(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    rate, spikes = 2000.0, {3.2: 1.0, 5.4: -1.0, 7.9: 0.6}
    spec = StreamSpec((2,), rate_hz=rate, channels=("noise", "spikes"), units=("uV",))
    time = grid(rate, round(10 * rate))
    data = np.random.default_rng(1).normal(scale=0.05, size=(len(time), 2))
    for second, height in spikes.items():
        data[round(second * rate), 1] = height
    write_recording(tmp_path / "noise.mcap", [Series("noise", spec, time + 1_700_000_000 * NS, data)], {})
    with page_process(tmp_path, "view", "noise.mcap") as process:
        browser.open(process.url)
        browser.value("document.documentElement.dataset.theme = 'light'")
        shown(browser, 10, 5)
        browser.wait("document.querySelector('.signal').dataset.points > 500")
        script = "(o => [o.offsetLeft, o.offsetTop, o.clientWidth, o.clientHeight])(document.querySelector('.signal .u-over'))"
        left, top, width, height = browser.value(script)
        for c in (0, 1):
            pixels = np.array(browser.like(".signal canvas", SHADES[c], within=60))
            middle, half = (data[:, c].max() + data[:, c].min()) / 2, np.ptp(data[:, c]) / 2
            found = middle + (top + (c + 0.5) * height / 2 - pixels[:, 1] - 0.5) / (0.46 * height / 2) * half
            pixel = half / (0.46 * height / 2)
            seconds = (pixels[:, 0] + 0.5 - left) / width * 10
            for column in np.unique(pixels[:, 0])[3:-3]:
                here, at = found[pixels[:, 0] == column], seconds[pixels[:, 0] == column][0]
                near = data[max(0, round((at - 0.03) * rate)) : round((at + 0.03) * rate), c]
                assert near.min() - 1.5 * pixel < here.min() and here.max() < near.max() + 1.5 * pixel
                assert len(here) > 1, "noise fills more than a line"
            if c == 1:
                for second, value in spikes.items():
                    here = found[abs(seconds - second) < 0.03]
                    assert abs((here.max() if value > 0 else here.min()) - value) < 1.5 * pixel, (
                        second,
                        "the spike is lost",
                    )
        assert browser.complaints == []


@pytest.mark.nightly
def test_a_stream_that_fell_silent_is_greyed_and_says_since_when(browser: LiveBrowser, tmp_path: Path) -> None:
    (tmp_path / "silent.yaml").write_text(
        "name: silent\npage: {panels: [{kind: signal, of: over.emg}, {kind: signal, of: board.emg}]}\n"
        "nodes:\n  over: {use: devices.people.treadmill.Treadmill, duration_s: 2}\n"
        "  board: {use: devices.people.treadmill.Treadmill}\n"
    )
    with page_process(tmp_path, "run", "silent.yaml", "--view", "none", "-o", "s") as process:
        browser.open(process.url)
        browser.wait("document.querySelector('.signal.stale output')?.textContent.includes('since')")
        text = browser.value("document.querySelector('.signal.stale output').textContent")
        assert browser.value("document.querySelector('.signal').getAttribute('aria-label')") == "over.emg"
        assert browser.value("getComputedStyle(document.querySelector('.stale .body')).filter") == "grayscale(1)"
        browser.wait("document.querySelectorAll('.panel')[1].dataset.points > 100")
        browser.wait("!document.querySelectorAll('.panel')[1].classList.contains('stale')")
        assert browser.complaints == []
        assert process.stop() == 0
    with Recording.open(tmp_path / "s") as recording:
        last = recording.streams["over.emg"].last
    found = re.fullmatch(r"nothing for \d+ s, since (\d+:\d+:\d+)", text)
    assert last and found, text
    stopped, reported = datetime.fromtimestamp(last / NS), datetime.strptime(found[1], "%H:%M:%S")
    reported = reported.replace(stopped.year, stopped.month, stopped.day)
    assert ((reported - stopped).total_seconds() + 2) % 86400 < 60, (
        "it fell silent when it was over, or when the page heard of it"
    )


REACHED = """
(() => { const e = document.activeElement; if (!e || e === document.body) return null;
  e.dataset.reached = '1'; const s = getComputedStyle(e);
  return [e.tagName + ' ' + (e.getAttribute('aria-label') ?? e.textContent.slice(0, 30)), s.outlineStyle, parseFloat(s.outlineWidth),
    e.matches(':focus-visible')]; })()
"""
UNREACHED = """
[...document.querySelectorAll('button, select, input, textarea, a[href], [tabindex]:not([tabindex="-1"]), [role=slider]')]
  .filter(e => e.getClientRects().length && !e.disabled && !e.dataset.reached).map(e => e.outerHTML.slice(0, 120))
"""


@pytest.mark.parametrize("theme", rest_nightly("light", "dark"))
def test_all_that_can_be_done_is_reached_by_keys_and_the_focus_is_seen(
    browser: LiveBrowser, tmp_path: Path, theme: str
) -> None:
    (tmp_path / "small.yaml").write_text(SMALL)
    with page_process(tmp_path, "run", "small.yaml", "--view", "none", "--no-record") as process:
        browser.open(process.url)
        browser.value(f"document.documentElement.dataset.theme = '{theme}'")
        browser.wait("document.querySelector('.signal')?.dataset.points > 100")
        press(browser, "arrange")
        browser.value("document.querySelector('h1').tabIndex = -1; document.querySelector('h1').focus()")
        for _ in range(300):
            browser.press("Tab")
            found = browser.value(REACHED)
            if found is None:
                break
            name, style, width, visible = found
            assert visible and style == "solid" and width >= 2, (name, "has the focus, and does not show it")
        assert browser.value(UNREACHED) == []
        press(browser, "arrange")
        by_keys(browser)
        assert browser.complaints == []


def press(browser: LiveBrowser, name: str) -> None:
    """Press a button of the tool bar by its key."""
    browser.value(f"[...document.querySelectorAll('#controls button')].find(b => b.textContent === '{name}').focus()")
    browser.type(" ")


def by_keys(browser: LiveBrowser) -> None:
    """A slider, a list, a held picture and a mark without a mouse."""
    browser.value("document.querySelector('input[type=range]').focus()")
    before = float(browser.value("document.activeElement.value"))
    browser.press("ArrowRight", 2)
    assert float(browser.value("document.querySelector('input[type=range]').value")) > before
    browser.wait("document.querySelector('.log').textContent.includes('set on the page')")
    browser.value("document.activeElement.blur()")
    browser.type("p")
    browser.wait(
        "[...document.querySelectorAll('button')].find(b => b.textContent === 'pause').getAttribute('aria-pressed') === 'true'"
    )
    picture = "document.querySelector('.signal canvas').toDataURL()"
    browser.wait(
        f"(async () => {{ const a = {picture}, n = +document.body.dataset.drawn;"
        "while (document.body.dataset.drawn < n + 10) await new Promise(requestAnimationFrame);"
        f"return a === {picture}; }})()"
    )  # scales give way for a while
    held = browser.value(picture)
    browser.type("7")
    browser.wait("document.querySelector('.log').textContent.includes('annotated on the page')")
    drawn = browser.value("+document.body.dataset.drawn")
    browser.wait(f"document.body.dataset.drawn > {drawn} + 5")
    assert browser.value(picture) == held, "a held picture stays, while the session goes on"
    browser.type("p")
    browser.wait(f"{picture} !== {json.dumps(held)}")
    browser.value("document.querySelector('select[aria-label=\"seconds shown\"]').focus()")
    browser.press("ArrowDown")
    browser.wait("document.querySelector('select[aria-label=\"seconds shown\"]').value === '30'")
    browser.value("document.activeElement.blur()")


def test_a_scene_turns_by_keys(browser: LiveBrowser, tmp_path: Path) -> None:
    time = np.arange(50) * NS // 10 + 1_700_000_000 * NS
    rng = np.random.default_rng(1).normal(size=(5, 3))
    spec = StreamSpec((5, 3), rate_hz=10.0, channels=tuple("abcde"), units=("m",))
    write_recording(tmp_path / "points.mcap", [Series("points", spec, time, np.repeat(rng[None], 50, axis=0))], {})
    with page_process(tmp_path, "view", "points.mcap") as process:
        browser.open(process.url)
        browser.wait("document.querySelector('.scene')?.dataset.points === '5'")
        places = "[...document.querySelectorAll('.scene .name')].map(e => e.style.transform).join()"
        browser.value("document.querySelector('.scene').focus()")
        for key, shift in (("ArrowLeft", True), ("ArrowUp", True), ("+", False), ("-", False)):
            before = browser.value(places)
            browser.press(key, 2, shift=shift)
            browser.wait(f"{places} !== {json.dumps(before)}")
        assert browser.complaints == []


def test_nothing_is_fetched_from_elsewhere_and_sliders_have_bounds_and_units(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    (tmp_path / "small.yaml").write_text(SMALL)
    with page_process(tmp_path, "run", "small.yaml", "--view", "none", "--no-record") as process:
        browser.open(process.url, 375, 667)
        browser.wait("document.querySelector('.signal')?.dataset.points > 50")
        with process.client() as client:
            until(client, "hello")
        place = urlsplit(process.url).netloc
        assert {
            urlsplit(url).netloc for url in browser.fetched if not url.startswith(("data:", "blob:", "about:"))
        } == {place}
        assert any(url.startswith("ws://") for url in browser.fetched)
        slider = browser.value(
            "(s => [s.min, s.max, s.value, s.nextSibling.textContent, s.parentElement.firstChild.textContent])"
            "(document.querySelector('input[type=range]'))"
        )
        assert slider == ["0", "100", "40", "40 uV", "level"]
        small = browser.value(
            "[...document.querySelectorAll('button, select, input')].filter(e => e.getClientRects().length)"
            ".filter(e => Math.min(e.clientWidth, e.clientHeight) < 12 || e.offsetHeight < 24).map(e => e.outerHTML)"
        )
        assert small == [], "too small for a finger (WCAG 2.5.8: 24 px)"
        assert browser.value("document.documentElement.scrollWidth <= innerWidth")
        assert browser.complaints == []
