"""What a browser's main thread takes to draw 16 channels: headless Chromium with software rendering, the rest of the machine apart."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from bench.page_session import GRAPH, session
from bench.report import Goal, Section, short
from tests.support.browser import CHROMIUM
from tests.support.live_browser import LiveBrowser, live_browser

STRIPS = GRAPH.replace(
    "nodes:", "page: {panels: [{kind: signal, of: board, wide: 4, tall: 3, window_s: 2}]}\nnodes:", 1
)
WIDTH = 1920


def drawn(seconds: float) -> Section:
    """How long the page's main thread works for each picture of one strip chart."""
    title = "Drawing 16 channels in headless Chromium"
    if CHROMIUM is None:
        return Section(title, notes=["Left out: no chromium here."])
    with ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        browser = stack.enter_context(live_browser(place))
        _, url = stack.enter_context(session(place, STRIPS, page=True))
        browser.open(url.replace("ws", "http", 1).removesuffix("socket"), WIDTH, 1080)
        browser.wait("document.querySelector('.signal')?.dataset.points > 1000")
        browser.ask("Performance.enable", timeDomain="threadTicks")
        time.sleep(2)
        busy, pictures = spent(browser), shown(browser)
        time.sleep(seconds)
        busy, pictures = spent(browser) - busy, shown(browser) - pictures
        points = int(browser.value("document.querySelector('.signal').dataset.points"))
    each = 1000 * busy / max(1, pictures)
    row = [f"16 x {points} points, {WIDTH} px wide", short(each), short(pictures / seconds)]
    goal = Goal("page: pictures of 16 channels that the main thread could draw", 1000 / each, 60.0, "/s", least=True)
    return Section(title, ["", "ms of the main thread per picture", "pictures/s (at most 60)"], [row], goals=[goal])


def spent(browser: LiveBrowser) -> float:
    """Processor time of the page's main thread so far (s)."""
    found = {m["name"]: m["value"] for m in browser.ask("Performance.getMetrics")["metrics"]}
    return float(found["TaskDuration"])


def shown(browser: LiveBrowser) -> int:
    return int(browser.value("+document.body.dataset.drawn"))
