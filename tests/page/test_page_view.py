"""A recording on the page: pyramids against the samples themselves, reading from any moment, and a person who scrubs and finds a gap."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.page.marks import MARKS
from kinegraph.devices.page.recorded.pyramid import Pyramid
from kinegraph.devices.page.recorded.viewing import RecordingHub
from kinegraph.devices.page.transfer.wire import Look, decode
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, grid
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.manual import ANNOTATION
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.browser import needs_browser
from tests.support.live_browser import live_browser
from tests.support.page_session import PageProcess, needs_page, page_process

RATE_HZ, SECONDS, GAP_S = 500.0, 40, 25
SIGNAL = StreamSpec((3,), rate_hz=RATE_HZ, channels=("a", "b", "c"), units=("uV",))
FRAMES = StreamSpec((12, 16), np.dtype("<u2"), 5.0, units=("mm",))
START = 1_700_000_000 * NS


def second(k: int) -> Chunk:
    """The signal's `k`-th second."""
    time = grid(RATE_HZ, int(RATE_HZ), start_ns=START + k * NS)
    data = np.random.default_rng(k).normal(size=(len(time), 3)) + k
    return Chunk(time, data, int(time[-1]), 500 if k == GAP_S + 1 else 0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 s of a signal that lacks the 25th, frames with their number as pixels, and a mark."""
    folder = tmp_path_factory.mktemp("view") / "s"
    recorder = Recorder(folder, {"graph": "", "session": {"subject": "<i>S1</i>"}}, RecordingOptions(), wait=True)
    signal = recorder.add_stream("emg", SIGNAL, "input")
    frames = recorder.add_stream("camera", FRAMES, "input")
    marks = recorder.add_stream("annotations", StreamSpec((), ANNOTATION, units=("ns", "")), "input")
    sequence = 0
    for k in range(SECONDS):
        if k != GAP_S:
            recorder.write(signal, second(k), START + (k + 1) * NS, sequence)
        stamps = START + k * NS + np.arange(5) * (NS // 5)
        pixels = np.full((5, 12, 16), k + 1, "<u2")
        pixels[:, 0, :] = 0
        recorder.write(frames, Chunk(stamps, pixels, int(stamps[-1])), START + (k + 1) * NS, sequence + 1)
        sequence += 2
        if k == 30:
            mark = np.array([(START + 30 * NS, "here")], ANNOTATION)
            recorder.write(marks, Chunk(np.array([START + 30 * NS]), mark, START + 30 * NS), START + 31 * NS, sequence)
            sequence += 1
    recorder.close()
    recorder.check()
    return folder


def look(begin: float, end: float, at: float, points: int = 1000) -> Look:
    return Look([0], begin, end, at, points)


@pytest.mark.parametrize("begin", [0.0, 7.3, 24.99, 25.5, 39.9])
def test_a_stream_is_read_from_any_moment_on(recording: Path, begin: float) -> None:
    at = START + round(begin * NS)
    with Recording.open(recording) as opened:
        time, data = opened.read("emg")
        chunks = list(opened.chunks_from("emg", at))
    found = np.concatenate([c.time for c in chunks])
    assert found[0] <= time[np.searchsorted(time, at)]
    assert found[-1] == time[-1]
    assert np.array_equal(np.concatenate([c.data for c in chunks]), data[len(time) - len(found) :])


def test_a_pyramid_holds_the_least_and_the_greatest_value_of_every_piece_and_the_gap() -> None:
    chunks = [second(k) for k in range(SECONDS) if k != GAP_S]
    time, data = np.concatenate([c.time for c in chunks]), np.concatenate([c.data for c in chunks])
    shares: list[float] = []
    pyramid = Pyramid(SIGNAL, int(time[0]), int(time[-1]), pieces=900)
    pyramid.build(chunks, shares.append)
    piece = (time - time[0]) // pyramid.width
    for number in range(pyramid.count):
        rows = data[piece == number].astype(np.float32)
        if len(rows):
            held = pyramid.pieces.tolist().index(number)
            assert np.array_equal(pyramid.low[held], rows.min(axis=0))
            assert np.array_equal(pyramid.high[held], rows.max(axis=0))
        else:
            assert number not in pyramid.pieces
    assert [(round((a - START) / NS, 2), round((b - START) / NS, 2)) for a, b in pyramid.gaps] == [(25.0, 26.0)]
    assert shares == sorted(shares)


def test_what_is_seen_from_afar_spans_what_is_seen_close_by(recording: Path) -> None:
    with Recording.open(recording) as opened:
        hub = RecordingHub(opened)
        hub.build(lambda message: None)
        number = hub.names.index("emg")
        far = hub.seen(number, look(0, 40, 20, points=200))
        near = hub.seen(number, look(10, 11, 10.5))
        assert far and near
        (a, low), (b, exact) = decode(far), decode(near)
    assert a["thin"] and not b["thin"]
    assert b["n"] == 500
    values = np.frombuffer(low[8 * a["n"] :], np.float32).reshape(2, 3, a["n"])
    whole = np.concatenate([second(k).data for k in range(SECONDS) if k != GAP_S])
    assert np.nanmin(values) == np.float32(whole.min())
    assert np.nanmax(values) == np.float32(whole.max())
    assert np.isnan(values[0, 0]).any()
    assert np.array_equal(
        np.frombuffer(exact[8 * 500 :], np.float32).reshape(3, 500), second(10).data.T.astype(np.float32)
    )


def test_without_an_overview_there_is_a_picture_at_once_and_the_rest_comes_with_progress(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recording, "overviews", lambda self, name: [])
    with Recording.open(recording) as opened:
        hub = RecordingHub(opened)
        number = hub.names.index("emg")
        near = hub.seen(number, look(10, 20, 15))
        assert near and decode(near)[0]["n"] > 900 and not hub.pyramids
        rows: list[bytes] = []
        hub.build(rows.append)
        shares = [header["share"] for header, _ in map(decode, rows) if header["t"] == "progress"]
        assert len(shares) > 10 and shares == sorted(shares) and shares[-1] == 1
        gaps = [header["gaps"] for header, _ in map(decode, rows) if header["t"] == "gaps" and header["s"] == number]
        assert [round(begin) for begin, _ in gaps[-1]] == [GAP_S]
        assert hub.seen(number, look(0, 40, 20, points=200))


def test_panels_stand_as_arranged_although_a_file_that_the_graph_names_is_elsewhere(tmp_path: Path) -> None:
    graph = """
page:
  panels: [{kind: signal, of: board.emg, title: legs, wide: 2}, {kind: cycles, of: bands.low}, {kind: theirs, of: board.emg}]
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  bands: {use: operators.cycles.statistics.norms.NormativeBands, from: {closed: board.touchdown, cycles: board.emg}, file: elsewhere.csv}
"""
    write_recording(
        tmp_path / "s.mcap",
        [Series("board.emg", SIGNAL, second(0).time, second(0).data)],
        {"graph": graph, "session": {}},
    )
    with Recording.open(tmp_path / "s.mcap") as opened:
        panel, *others, marks = decode(RecordingHub(opened).greeting())[0]["panels"]
    assert marks["title"] == "marks"
    assert all(other["missing"] == ["bands.low"] for other in others)
    assert (panel["kind"], panel["of"], panel["title"], panel["wide"]) == ("signal", ["board.emg"], "legs", 2)


def recorded_by(graph: str, path: Path) -> Path:
    series = Series("board.emg", SIGNAL, second(0).time, second(0).data)
    write_recording(path, [series], {"graph": graph, "session": {}})
    return path


@pytest.mark.parametrize(
    "use", ["{module}.Rectify", "kinegraph.__main__.main", "operators.__main__.X", "test.__main__.X", "..X"]
)
def test_looking_at_a_recording_imports_no_module_that_its_graph_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, use: str
) -> None:
    module = f"stranger_of_{abs(hash(tmp_path))}"
    (tmp_path / f"{module}.py").write_text(f"from pathlib import Path\nPath({str(tmp_path / 'ran')!r}).touch()\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    graph = f"""
page: {{panels: [{{kind: signal, of: [board.emg, other]}}]}}
nodes:
  board: {{use: devices.people.treadmill.Treadmill}}
  other: {{use: {use.format(module=module)}, from: board.emg}}
"""
    with Recording.open(recorded_by(graph, tmp_path / "s.mcap")) as opened:
        before = {*sys.modules}
        panel = decode(RecordingHub(opened).greeting())[0]["panels"][0]
    assert (panel["kind"], panel["of"]) == ("signal", ["board.emg"])
    assert not (tmp_path / "ran").exists()
    assert not {
        name for name in {*sys.modules} - before if name.startswith(("stranger", "test.", "kinegraph.__main__"))
    }


def test_looking_at_a_recording_opens_no_operator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graph = """
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  rect: {use: operators.filters.rectify.Rectify, from: board.emg}
"""

    def refuse(*_: object) -> None:
        raise AssertionError("an operator was opened")

    monkeypatch.setattr("kinegraph.stream.graph.reading.opening.open_nodes", refuse)
    monkeypatch.setattr("kinegraph.stream.graph.reading.load.open_nodes", refuse)
    with Recording.open(recorded_by(graph, tmp_path / "s.mcap")) as opened:
        assert decode(RecordingHub(opened).greeting())[0]["panels"]


def test_a_registered_package_brings_its_panels_to_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = f"gait_lab_of_{abs(hash(tmp_path))}"
    (tmp_path / f"{package}.py").write_text(
        "from dataclasses import dataclass\nfrom kinegraph.operators.filters.rectify import Rectify\n"
        "@dataclass(frozen=True)\nclass Dial(Rectify):\n    panels = {'dial': 'dial.js'}\n"
    )
    (tmp_path / "dial.js").write_text("export default () => ({ draw() {} });")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(
        "kinegraph.stream.graph.components.entry_points", lambda group: [EntryPoint("lab", package, group)]
    )
    graph = f"nodes:\n  board: {{use: {package}.Dial, from: x}}\n"
    with Recording.open(recorded_by(graph, tmp_path / "s.mcap")) as opened:
        hub = RecordingHub(opened)
        assert decode(hub.greeting())[0]["panels"][0] == {
            "kind": "dial",
            "of": ["board.emg"],
            "title": "board",
            "missing": [],
        }
        assert [*hub.modules] == ["dial"]


def test_a_view_from_afar_takes_no_more_memory_than_its_samples(tmp_path: Path) -> None:
    wide = StreamSpec((60_000,), np.dtype("<f4"))
    stamps = np.array([START, START + 3600 * NS])
    write_recording(tmp_path / "s.mcap", [Series("wide", wide, stamps, np.ones((2, 60_000), "<f4"))], {"graph": ""})
    with Recording.open(tmp_path / "s.mcap") as opened:
        hub = RecordingHub(opened)
        hub.build(lambda message: None)
        pyramid = hub.pyramids[0]
        assert pyramid.low.shape == (2, 60_000)
        made = hub.seen(0, look(-1, 3601, 0, points=10_000))
    assert made and len(made) < 10 * 2 * 60_000 * 4


def test_a_view_from_afar_of_many_channels_and_many_moments_is_bounded() -> None:
    spec = StreamSpec((1000,), np.dtype("<f4"))
    time = START + np.arange(2000) * NS
    pyramid = Pyramid(spec, int(time[0]), int(time[-1]), most=100_000)
    pyramid.build([Chunk(time, np.zeros((2000, 1000), "<f4"), int(time[-1]))], lambda share: None)
    assert pyramid.low.size <= 101_000


def test_a_look_that_would_read_too_much_shows_what_is_seen_from_afar(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinegraph.devices.page.recorded.reading.MAX_READ", 3000)
    with Recording.open(recording) as opened:
        hub = RecordingHub(opened)
        hub.build(lambda message: None)
        pyramid = hub.pyramids[hub.names.index("emg")]
        made = hub.seen(hub.names.index("emg"), look(0, 40, 20, points=10_000))
    assert made and decode(made)[0]["w"] == pyramid.width / NS


@pytest.mark.parametrize("rate_hz", [1e-300, 1e-12, 1e12, 1e300])
def test_a_rate_that_no_stamps_can_have_is_refused(rate_hz: float) -> None:
    with pytest.raises(ValueError, match="rate_hz is"):
        StreamSpec((1,), rate_hz=rate_hz)


def test_a_stream_with_stamps_that_run_backwards_is_left_out_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded_by("", tmp_path / "s.mcap")
    with Recording.open(path) as opened:
        stream = opened.streams["board.emg"]
        stream.first, stream.last = stream.last, stream.first
        hub = RecordingHub(opened)
    assert hub.names == [MARKS]
    assert "run backwards" in capsys.readouterr().out


@pytest.mark.parametrize(("at", "value"), [(0.0, 1), (12.35, 13), (39.9, 40)])
def test_the_frame_of_a_moment_is_the_last_one_before_it(recording: Path, at: float, value: int) -> None:
    with Recording.open(recording) as opened:
        hub = RecordingHub(opened)
        made = hub.seen(hub.names.index("camera"), look(at - 1, at + 1, at))
        assert made
        header, pixels = decode(made)
    assert header["at"] <= at < header["at"] + 0.2 + 1e-6
    assert set(np.frombuffer(pixels, "<u2")) == {0, value}


@pytest.fixture
def view(recording: Path, tmp_path: Path) -> Iterator[PageProcess]:
    with page_process(tmp_path, "view", recording) as process:
        yield process


@needs_page
@needs_browser
@pytest.mark.timeout(200)
def test_a_person_finds_the_gap_and_the_mark_and_scrubs_all_panels(view: PageProcess, tmp_path: Path) -> None:
    with live_browser(tmp_path) as browser:
        browser.open(view.url, height=1600)
        browser.wait("document.getElementById('line').dataset.gaps === '1'")
        assert "<i>S1</i>" in browser.value("document.getElementById('name').textContent")
        browser.wait("document.getElementById('line').dataset.events === '1'")
        browser.type("g")
        browser.wait("Math.abs(document.querySelector('#line canvas').getAttribute('aria-valuenow') - 25) < .01")
        browser.wait("document.querySelector('.signal').dataset.gaps === '1'")
        browser.wait(
            "document.querySelector('.frame').dataset.least === '25' || document.querySelector('.frame').dataset.least === '26'"
        )
        assert browser.value("document.querySelector('.frame').dataset.invalid") == "16"
        browser.drag("#line canvas", 0.3, 0.9)
        browser.wait("document.querySelector('#line canvas').getAttribute('aria-valuenow') > 33")
        browser.wait("document.querySelector('.frame').dataset.least > 33")
        browser.wait("document.querySelector('.table table').textContent.includes('here')")
        assert browser.colours("#line canvas") > 4
        browser.type(" ")
        before = float(browser.value("document.querySelector('#line canvas').getAttribute('aria-valuenow')"))
        browser.wait(f"document.querySelector('#line canvas').getAttribute('aria-valuenow') > {before}")
        assert browser.complaints == []
