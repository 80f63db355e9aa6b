"""Hostile names in every field of every page, in a real browser: they are shown as they are, and nothing that they ask for happens."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.lsl.network import library
from kinegraph.devices.reports.night import archive
from kinegraph.devices.reports.night.numbers import table
from kinegraph.devices.reports.night.page import render as render_night
from kinegraph.devices.reports.session.contents.data import Noticed, Stream
from kinegraph.devices.reports.session.page import render as render_session
from kinegraph.devices.reports.training.page import render as render_training
from kinegraph.devices.reports.training.rows import nothing_done, take
from kinegraph.stream.chunk import NS
from tests.outlets.test_report_page import sample
from tests.support import night_made
from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.mosquitto import broker, listening
from tests.support.page_session import needs_page, page_process

pytestmark = [needs_browser, pytest.mark.timeout(280)]

INJECTED = "document.querySelectorAll('img[src^=x], [onerror], [onload], a[href^=javascript], base, iframe').length"
"""What no page of ours has: it would be made of a name."""


def hostile(i: object) -> str:
    """A name that would leave an attribute, an element or a script, and says if it did; a different one for each `i`."""
    return f"""n{i}'"></svg></title></style></script><img src=x onerror="pwned={i!r}"><script>pwned=1</script>&lt;&amp;{{{{7*7}}}}\u2028"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


def harmless(browser: LiveBrowser) -> bool:
    return bool(browser.value(f"typeof pwned === 'undefined' && !{INJECTED}"))


def shows(browser: LiveBrowser, name: str) -> bool:
    """Whether a name stands on the page as it is, in a text or an attribute that is read aloud."""
    return bool(browser.value(f"document.documentElement.textContent.includes({name!r})"))


class Texts:
    """Every text within a dataclass replaced, but a muscle's verdict, which is one of three words of ours; `names`: by what."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def within(self, thing: Any) -> Any:
        if isinstance(thing, str):
            self.names.append(hostile(len(self.names)))
            return self.names[-1]
        if isinstance(thing, dict):
            return {self.within(key): self.within(value) for key, value in thing.items()}
        if isinstance(thing, list | tuple):
            return type(thing)(self.within(one) for one in thing)
        if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
            fields = {
                f.name: self.within(getattr(thing, f.name)) for f in dataclasses.fields(thing) if f.name != "verdict"
            }
            return dataclasses.replace(thing, **fields)
        return thing


def opened(browser: LiveBrowser, folder: Path, html: str) -> None:
    page = folder / "page.html"
    page.write_text(html, encoding="utf-8")
    browser.open(page.as_uri())
    assert browser.complaints == [] and harmless(browser)


def test_the_session_report(browser: LiveBrowser, tmp_path: Path) -> None:
    report, curves = sample()
    report.streams = [Stream("emg", "2 channels", 100, 1, 30)]
    report.alarms, report.alarmed = [Noticed(1.0, 2.0, "patient", "flat")], 1
    report.pairs_note = "note"
    texts = Texts()
    opened(browser, tmp_path, render_session(texts.within(report), curves))
    missing = [name for name in texts.names if not shows(browser, name)]
    assert len(texts.names) > 30 and not missing, (len(texts.names), [name[:6] for name in missing])


def test_the_night_report(browser: LiveBrowser, tmp_path: Path) -> None:
    night_made.whole(tmp_path / "nights")
    ((folder, facts),) = archive.nights(tmp_path / "nights")
    epochs = archive.read_epochs(folder)
    facts.sleeper, facts.session = hostile("sleeper"), {hostile("key"): hostile("value"), "subject": hostile("subject")}
    facts.settings = [[hostile("node"), hostile("use"), hostile("parameters")]]
    facts.versions = [[hostile("package"), hostile("version")]]
    facts.moved = [[epochs.onset[5].item(), 1.0, 2.0]]
    facts.switched = [[epochs.onset[9].item(), hostile("switched")]]
    facts.meta = {**facts.meta, "method": hostile("method"), "calibration": hostile("calibration")}
    for kind in epochs.texts:
        epochs.texts[kind] = epochs.texts[kind].astype("U200")
        epochs.texts[kind][100:110] = hostile(kind)
    page = render_night(facts, epochs, archive.read_map(folder), table(facts, epochs), {hostile("f"): hostile("why")})
    opened(browser, tmp_path, page)
    for name in ("subject", "value", "node", "use", "parameters", "version", "f", "why"):
        assert shows(browser, hostile(name)), name


def test_the_training_report(browser: LiveBrowser, tmp_path: Path) -> None:
    training = nothing_done()
    for k in range(3):
        event = dict.fromkeys(training.repetitions.dtype.names or (), k) | {
            "activity": 1,
            "onset": k * NS,
            "duration_s": 1.0,
        }
        take(training, "repetitions", event | {"name": "<img src=x>", "moves": "<svg onload=x>"})
    take(training, "sets", dict.fromkeys(training.sets.dtype.names or (), 1) | {"onset": 0, "end": 3 * NS})
    training.began, training.ended = 0, 3 * NS
    page = render_training(
        hostile("title"), {hostile("key"): hostile("value")}, training, hostile("unit"), hostile("table"), 0.5, 1
    )
    opened(browser, tmp_path, page)
    for name in ("title", "value", "unit", "table"):
        assert shows(browser, hostile(name)), name
    assert shows(browser, "<img src=x>") and shows(browser, "<svg onload=x>")


# the live page -------------------------------------------------------------------------------------------------------

GRAPH = """
name: {name}
session: {{{session}: {session}}}
nodes:
  amp: {{use: devices.lsl.LslInlet, name: {emg}, probe: true}}
  marks: {{use: devices.lsl.LslInlet, name: {marks}, markers: true, text_width: 200}}
  light: {{use: devices.mqtt.MqttSwitch, name: light, title: {session}, broker: {{host: 127.0.0.1, port: {port}}}, device: {{id: lamp}}}}
  level: {{use: stream.manual.Value, initial: 40, least: 0, most: 100, unit: {session}}}
"""


def sending(name: str, stop: Event) -> Thread:
    """A sender on LSL of which every text is hostile, numbers and markers, until `stop`."""
    lsl = library()
    emg = lsl.StreamInfo(name, hostile("type"), 2, 100.0, "float32", hostile("source"))
    channels = emg.desc().append_child("channels")
    for i in range(2):
        channel = channels.append_child("channel")
        channel.append_child_value("label", hostile(f"channel{i}"))
        channel.append_child_value("unit", hostile("unit"))
    emg.desc().append_child("acquisition").append_child_value("manufacturer", hostile("maker"))
    marks = lsl.StreamInfo(f"{name} marks", hostile("type"), 1, 0.0, "string", hostile("source of marks"))
    outlets = lsl.StreamOutlet(emg), lsl.StreamOutlet(marks)

    def send() -> None:
        n = 0
        while not stop.wait(0.01):
            outlets[0].push_sample([np.sin(n / 9), np.cos(n / 9)])
            if n % 50 == 0:
                outlets[1].push_sample([hostile("mark")])
            n += 1

    thread = Thread(target=send, daemon=True)
    thread.start()
    return thread


@needs_page
def test_the_live_page(browser: LiveBrowser, tmp_path: Path) -> None:
    import json

    name, stop = hostile(f"emg {time.time_ns()}"), Event()
    sender = sending(name, stop)
    graph = "<img src=x onerror=pwned=1>&lt;"  # a folder's name, and so short and without a slash
    texts = {"name": graph, "session": hostile("fact"), "emg": name, "marks": f"{name} marks"}
    try:
        with broker(tmp_path) as mosquitto, listening(mosquitto.port) as home:
            quoted = {key: json.dumps(text) for key, text in texts.items()}
            (tmp_path / "g.yaml").write_text(GRAPH.format(port=mosquitto.port, **quoted))
            with page_process(tmp_path, "run", "g.yaml", "--view", "none", "-o", "s") as process:
                browser.open(process.url)
                browser.wait("document.querySelector('.signal')?.dataset.points > 50")
                browser.wait("document.querySelector('.events')?.dataset.events > 1")
                home.wait_for("kinegraph/lamp/light/availability", "online")
                home.say("kinegraph/lamp/light/set", hostile("payload"))
                browser.wait(f"document.querySelector('.log').textContent.includes({'npayload'!r})")
                browser.type("m")
                browser.wait("document.activeElement.getAttribute('aria-label') === 'annotation'")
                browser.type(hostile("typed")[:40] + "\r")
                browser.wait("document.querySelector('.log').textContent.includes('ntyped')")
                for node in ("marks", "annotations"):
                    browser.value(
                        "(s => { s.value = [...s.options].find(o => o.textContent.split('.')[0] === "
                        f"'{node}').value; s.dispatchEvent(new Event('change')); }})"
                        "(document.querySelector('select[aria-label=stream]'))"
                    )
                    shown = hostile("mark")[:40] if node == "marks" else hostile("typed")[:40]
                    browser.wait(f"document.querySelector('.table table').textContent.includes({shown!r})")
                for shown in (graph, hostile("fact")):
                    assert shows(browser, shown), shown
                assert browser.value("document.title").startswith(graph)
                assert harmless(browser)
                assert browser.complaints == []
                assert process.stop() == 0
    finally:
        stop.set()
        sender.join()
