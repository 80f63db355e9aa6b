"""What the page draws on demand, or for one use: spectra, a panel of one's own, words, the hypnogram, self-similarity, both sides."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import spectrogram, welch

from kinegraph.devices.page.transfer import messages
from kinegraph.devices.page.transfer.catalogue import hello, own_modules
from kinegraph.devices.page.transfer.spectra import analysed, windows
from kinegraph.devices.page.transfer.wire import Analyse, asked, decode
from kinegraph.stream.chunk import NS, StreamSpec, grid
from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.graph.reading.page_section import GROUP
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.house.test_docs import HOUSE, blocks
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

pytestmark = pytest.mark.timeout(280)

RATE_HZ = 1000.0
TONES = StreamSpec((2,), rate_hz=RATE_HZ, channels=("low", "high"), units=("uV",))
SHADES = ("#1f5fa8", "#b0481c")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    """One test tries a script that the page's policy forbids, and the browser complains of it."""
    with live_browser(tmp_path_factory.mktemp("browser"), allowed="Executing inline script violates") as found:
        yield found


def choose(browser: LiveBrowser, panel: str, label: str, value: object) -> None:
    """Choose in a panel's list."""
    browser.value(
        f"(s => {{ s.value = {str(value)!r}; s.dispatchEvent(new Event('change')); }})"
        f"(document.querySelector('{panel} select[aria-label={label}]'))"
    )


def light(browser: LiveBrowser) -> None:
    browser.value("document.documentElement.dataset.theme = 'light'")


# spectra -------------------------------------------------------------------------------------------------------------


def tones(seconds: int = 8) -> tuple[np.ndarray, np.ndarray]:
    time = grid(RATE_HZ, seconds * 1000)
    t = time / NS
    noise = np.random.default_rng(1).normal(size=(len(t), 2))
    return time, noise + 20 * np.sin(2 * np.pi * np.array([60.0, 240.0]) * t[:, None])


def test_a_spectrum_is_welchs() -> None:
    time, data = tones()
    message = analysed(0, TONES, Analyse(0, "spectrum", 0, 8), time, data, 0)
    header, numbers = decode(message)
    size = 2 * (header["bins"] - 1)
    hz, expected = welch(data, RATE_HZ, "hann", size, axis=0, detrend="constant")
    found = np.frombuffer(numbers, "<f4").reshape(2, -1)
    assert header["bin_hz"] == hz[1]
    assert np.allclose(found, expected.T, rtol=1e-5)


def test_a_spectrogram_is_scipys() -> None:
    time, data = tones()
    header, numbers = decode(analysed(0, TONES, Analyse(0, "spectrogram", 0, 8, 1), time, data, int(time[0])))
    size, hop = 2 * (header["bins"] - 1), round(header["hop"] * RATE_HZ)
    _, at, expected = spectrogram(data[:, 1], RATE_HZ, "hann", size, size - hop, detrend="constant")
    count = header["windows"]
    assert np.allclose(np.frombuffer(numbers, "<f8", count), at, atol=2e-3)
    assert np.allclose(
        np.frombuffer(numbers[8 * count :], "<f4").reshape(count, -1).T, 10 * np.log10(expected), atol=0.01
    )


def test_no_window_reaches_across_a_gap_or_holds_a_missing_value() -> None:
    time, data = tones(4)
    time[2000:] += NS
    starts = windows(time, 256, 64, TONES.period_ns)
    assert len(starts) and not ((starts < 2000) & (starts + 256 > 2000)).any()
    data[1000:1010] = np.nan
    header, numbers = decode(analysed(0, TONES, Analyse(0, "spectrum", 0, 9), time, data, 0))
    assert header["bins"] and np.isfinite(np.frombuffer(numbers, "<f4")).all()
    assert decode(analysed(0, TONES, Analyse(0, "spectrum", 0, 9), time[:5], data[:5], 0))[0]["bins"] == 0


@pytest.mark.parametrize(
    "wrong",
    [
        '"what": "everything"',
        '"what": "spectrum", "begin": 9',
        '"what": "spectrum", "channel": "a"',
        '"what": "spectrum", "end": 1e99',
    ],
)
def test_what_cannot_be_analysed_is_refused(wrong: str) -> None:
    given = {"do": "analyse", "stream": 0, "begin": 0, "end": 1} | json.loads("{" + wrong + "}")
    with pytest.raises(ValueError):
        asked(json.dumps(given))


@needs_page
@needs_browser
def test_a_person_asks_for_spectra_of_a_recording(browser: LiveBrowser, tmp_path: Path) -> None:
    time, data = tones(10)
    write_recording(tmp_path / "tones.mcap", [Series("tones", TONES, time + 1_700_000_000 * NS, data)], {})
    with page_process(tmp_path, "view", "tones.mcap") as view:
        browser.open(view.url)
        browser.wait("document.querySelector('.signal')?.dataset.points > 100")
        light(browser)
        choose(browser, ".signal", "view", "spectrum")
        browser.wait("[60, 240].some(hz => Math.abs(document.querySelector('.signal').dataset.peak - hz) < 2)")
        width = browser.value("[...document.querySelectorAll('.signal canvas')].at(-1).width")
        browser.value("[...document.querySelectorAll('.signal canvas')].at(-1).id = 'analysis'")
        for colour, hz in zip(SHADES, (60, 240), strict=True):
            pixels = np.array(browser.like("#analysis", colour, within=60))
            highest = pixels[np.argmin(pixels[:, 1]), 0]
            assert abs(highest - (56 + (width - 64) * hz / 500)) < 8, (colour, "its peak stands elsewhere")
        choose(browser, ".signal", "view", "spectrogram")
        choose(browser, ".signal", "channel", 1)
        browser.wait(
            "(d => d.view === 'spectrogram' && Math.abs(d.peak - 240) < 4)(document.querySelector('.signal').dataset)"
        )
        yellow = np.array(browser.like("#analysis", "#fde725", within=60))
        height = browser.value("document.getElementById('analysis').height")
        assert abs(np.median(yellow[:, 1]) - (4 + (height - 24) * (1 - 240 / 500))) < 6
        choose(browser, ".signal", "view", "lines")
        browser.wait("document.querySelector('.signal').dataset.view === 'lines'")
        assert browser.complaints == []


# a panel of one's own ------------------------------------------------------------------------------------------------


def documented(folder: Path) -> None:
    """The files of the example in docs/extend/panel.md."""
    for _, name, text in blocks(HOUSE / "docs" / "extend" / "panel.md"):
        if name.startswith("bars."):
            (folder / name).write_text(text, encoding="utf-8")
            assert len(text.splitlines()) < 40


@needs_page
@needs_browser
def test_the_panel_of_the_docs_is_drawn_a_spectrum_is_live_and_the_engine_says_what_nodes_take(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    documented(tmp_path)
    with page_process(tmp_path, "run", "bars.yaml", "--view", "none", "--no-record") as process:
        browser.open(process.url)
        light(browser)
        browser.wait("document.querySelector('.signal')?.dataset.points > 200")
        drawn = browser.wait("document.querySelector('.bars')?.dataset.drawn")
        browser.wait(f"document.querySelector('.bars').dataset.drawn > {drawn} + 2")
        for colour in SHADES:
            assert len(browser.like(".bars canvas", colour, within=30)) > 20
        browser.wait("document.querySelector('.signal')?.dataset.points > 100")
        choose(browser, ".signal", "view", "spectrum")
        browser.wait("document.querySelector('.signal').dataset.peak > 0")
        heads = "[...document.querySelectorAll('.state th')].map(e => e.textContent)"
        browser.wait(f"{heads}.includes('CPU %')")
        browser.wait(
            "+[...document.querySelectorAll('.state tr')].find(r => r.cells[0].textContent === 'level')"
            f".cells[{heads}.indexOf('CPU %')].textContent >= 0"
        )
        browser.wait(
            "[...document.querySelectorAll('.graph svg .flow')].some(e => /^[0-9]{3,}.s$/.test(e.textContent))"
        )
        assert browser.complaints == []
        policy = (
            "(async () => { const s = document.createElement('script'); s.textContent = 'window.pwned = 1';"
            "document.head.append(s); return typeof pwned; })()"
        )
        assert browser.value(policy) == "undefined"


@needs_page
@needs_browser
def test_a_panel_that_fails_says_so_and_the_others_go_on(browser: LiveBrowser, tmp_path: Path) -> None:
    documented(tmp_path)
    (tmp_path / "bars.js").write_text("export default () => ({ draw() { throw new Error('<b>out of ink</b>'); } });")
    with page_process(tmp_path, "run", "bars.yaml", "--view", "none", "--no-record") as process:
        browser.open(process.url)
        browser.wait("document.querySelector('.bars output')?.textContent.includes('<b>out of ink</b>')")
        browser.wait("document.querySelector('.signal')?.dataset.points > 100")
        assert browser.complaints == []


def test_a_kind_that_nobody_brings_is_refused_with_those_there_are(tmp_path: Path) -> None:
    text = "page: {panels: [{kind: barz, of: board.emg}]}\nnodes: {board: {use: devices.people.treadmill.Treadmill}}\n"
    with pytest.raises(GraphError, match="barz"):
        load_text(text)


def test_an_installed_package_brings_a_panel_by_an_entry_point(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    module = f"dial_of_{tmp_path.name}"  # one that no earlier try of this test has left imported
    (tmp_path / f"{module}.py").write_text("from pathlib import Path\nPANEL = Path(__file__).with_name('dial.js')\n")
    (tmp_path / "dial.js").write_text("export default () => ({ draw() {} });")
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = EntryPoint("dial", f"{module}:PANEL", GROUP)
    monkeypatch.setattr(
        "kinegraph.stream.graph.reading.page_section.entry_points",
        lambda group, name: [entry] if name == "dial" else [],
    )
    text = "page: {panels: [{kind: dial, of: board.emg}]}\nnodes: {board: {use: devices.people.treadmill.Treadmill}}\n"
    graph = load_text(text)
    assert own_modules(graph.page) == {"dial": "export default () => ({ draw() {} });"}
    assert hello(graph, outside=False, mode="live", t0_ns=0)["panels"][0]["kind"] == "dial"
    (tmp_path / "dial.js").unlink()
    with pytest.raises(KinegraphError, match=r"dial\.js"):
        own_modules(graph.page)


# self-similarity -----------------------------------------------------------------------------------------------------

ALIKE = """
name: alike
record: [alike, stack]
page: {panels: [{kind: similarity, of: alike, title: alike, window_s: 60}]}
nodes:
  mocap: {use: devices.people.exerciser.Exerciser, noise_mm: 1, jitter_ms: 0, realtime: false, duration_s: 40}
  pose: {use: operators.features.pose.Pose, from: mocap.joints}
  even: {use: operators.timing.align.Align, from: {pose: pose}, rate_hz: 30, max_distance_s: 0.2}
  stack: {use: operators.features.stack.Stack, from: even}
  alike: {use: operators.features.self_similarity.SelfSimilarity, from: stack, every: 15, lags: 60}
"""


@needs_page
@needs_browser
def test_self_similarity_grows_and_is_the_recorded_one(browser: LiveBrowser, tmp_path: Path) -> None:
    (tmp_path / "alike.yaml").write_text(ALIKE)
    command = [KINEGRAPH, "run", "alike.yaml", "--view", "none", "-o", "s"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with Recording.open(tmp_path / "s") as recording:
        stamps, rows = recording.read("alike")
        begin = min(s.first for s in recording.streams.values() if s.first is not None)
        time, frames = recording.read("stack")
    kept = frames[np.searchsorted(time, stamps)]
    expected = np.sqrt(((kept[:, None] - kept[None]) ** 2).mean(axis=2))
    assert np.allclose(rows[10, :10], expected[10, 9::-1], rtol=1e-9)
    with page_process(tmp_path, "view", "s") as view:
        browser.open(view.url)
        browser.wait("document.querySelector('.similarity')?.dataset.size > 3")
        sizes = []
        for second in (12, 24):
            browser.press("Home")
            browser.press("ArrowRight", second // 6)
            browser.wait(f"Math.abs(document.body.dataset.looked - {second}) < .01")
            until = (stamps[stamps <= begin + second * NS][-1] - begin) / NS
            browser.wait(f"Math.abs(document.querySelector('.similarity').dataset.until - {until}) < 1e-3")
            n = int(browser.value("document.querySelector('.similarity').dataset.size"))
            sizes.append(n)
            pixels = np.array(browser.value(
                "(c => [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data])(document.querySelector('.similarity canvas'))"
            )).reshape(n, n, 4)  # fmt: skip
            assert (pixels == pixels.transpose(1, 0, 2)).all() and (
                pixels[range(n), range(n), :3] == (253, 231, 37)
            ).all()
            part = expected[:n, :n]
            order = np.argsort(part, axis=None)
            green = pixels[..., 1].ravel()[order].astype(int)
            assert (np.diff(green) <= 0).all(), "farther is not darker"
        assert sizes[0] < sizes[1]
        assert browser.complaints == []


# both sides ----------------------------------------------------------------------------------------------------------


def test_a_channel_that_the_last_curve_lacks_is_that_of_the_last_one_that_has_it() -> None:
    curves = np.full((3, 4, 2), np.nan)
    curves[0, :, 1], curves[1, :, 0], curves[2, :, 0] = 7, 1, 2
    made = messages.completed(curves)
    assert (made[:, 0] == 2).all() and (made[:, 1] == 7).all()
    assert np.isnan(curves[2, :, 1]).all(), "what was kept is as it was"


def test_the_page_of_both_legs_offers_its_stages() -> None:
    words = hello(load(Path("treadmill_both_legs")), outside=False, mode="live", t0_ns=0)["words"]
    assert {"stage warm-up", "next", "stage ", "end stage", "leave out "} <= set(words)
