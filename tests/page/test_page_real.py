"""The page drawn from real recordings that a graph replays, beside those of test_page_panels: what the canvas holds, pixel by pixel, is
what was recorded. A person's EMG on a treadmill, motion capture of actions, a day's counts at a wrist."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import spectrogram, welch

from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.devices.formats.gltf.vrm_reader import read_vrm
from kinegraph.devices.page.avatar_file import AVATAR
from kinegraph.operators.contacts.contacts import CONTACT
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, grid
from kinegraph.stream.domain.humanoid import BONES, to_humanoid
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.page.test_page_avatar import leg
from tests.page.test_page_panels import SHADES, Shown
from tests.page.test_page_views import choose, light
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.convert_run import DATA, arrays
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process
from tests.support.real import DATA_MARKS

pytestmark = [*DATA_MARKS, needs_page, needs_browser, pytest.mark.timeout(280), pytest.mark.xdist_group("page real")]

START = 1_700_000_000 * NS
GRAPH = """
name: real
record: [even, grid.place, grid.poses, plane.map, plane.explained, alike]
page:
  panels:
    - {kind: signal, of: treadmill.emg, title: raw EMG, wide: 4, tall: 2, window_s: 2}
    - {kind: events, of: treadmill.touchdown, title: touch-downs, wide: 2}
    - {kind: table, of: treadmill.touchdown, title: table}
    - {kind: avatar, of: body.pose, title: avatar}
    - {kind: similarity, of: alike, title: alike}
    - {kind: map, of: [plane.map, plane.explained], title: plane}
    - {kind: map, of: [grid.place, grid.poses], title: grid}
    - {kind: state}
    - {kind: graph}
    - {kind: log}
nodes:
  treadmill: {use: devices.recorded.RecordedStreams, path: real.mcap, of: treadmill}
  body: {use: devices.recorded.RecordedStreams, path: real.mcap, of: body}
  performer: {use: devices.recorded.RecordedStreams, path: real.mcap, of: performer}
  pose:
    use: operators.features.normalised_pose.NormalisedPose
    from: performer.joints
    origin: hips
    ahead: left
    markers: {hips: [lhipjoint, rhipjoint], left: [lhipjoint], hand_l: [lhand], hand_r: [rhand], knee_l: [lfemur], knee_r: [rfemur]}
  even: {use: operators.timing.align.Align, from: {pose: pose}, rate_hz: 30, max_distance_s: 0.2}
  grid: {use: operators.maps.pose_map.som.PoseGrid, from: even, rows: 4, columns: 5, learn_s: 2}
  plane: {use: operators.maps.motion_map.MotionMap, from: even}
  alike: {use: operators.features.self_similarity.SelfSimilarity, from: even, every: 15, lags: 40}
"""
SPAN_S = 2.0
FIRST, DARKEST, LIGHTEST = 56, (68, 1, 84), (253, 231, 37)
"""Where a spectrum begins in its canvas, and both ends of the colours."""


def recording(path: Path) -> None:
    """A walk, a body and actions, side by side in one."""
    assert DATA
    walk, mocap = arrays(DATA / "emg/emg_santuz_tw12.npz"), arrays(DATA / "segmentation/cmu86_full/86_01.npz")
    pose = next(s for s in read_bvh(DATA / "steering/cmu_131_01_scaled.bvh", "m") if s.name.endswith("pose"))
    emg = StreamSpec((13,), walk["emg_uV"].dtype, 1000.0, channels=tuple(walk["names"].tolist()), units=("uV",))
    joints = StreamSpec(
        (31, 3), mocap["joints_cm"].dtype, 30.0, channels=tuple(mocap["joint_names"].tolist()), units=("cm",)
    )
    onset = START + np.round((walk["touchdown_s"] - walk["t_s"][0]) * NS).astype("<i8")
    contacts = StreamSpec((), CONTACT, units=("ns",), meta={"side": "right"})
    kept = mocap["joints_cm"][:600]
    write_recording(
        path,
        [
            Series("treadmill.emg", emg, grid(1000.0, len(walk["emg_uV"]), start_ns=START), walk["emg_uV"]),
            Series("treadmill.touchdown", contacts, onset, onset.view(CONTACT)),
            Series("body.pose", pose.spec, START + pose.time - pose.time[0], pose.data),
            Series("performer.joints", joints, grid(30.0, len(kept), start_ns=START), kept),
        ],
        {"graph": "", "session": {"subject": "of the archive"}},
    )  # fmt: skip


def made(folder: Path, graph: str, name: str) -> Path:
    """What a graph makes of a real recording, recorded again."""
    (folder / f"{name}.yaml").write_text(graph)
    command = [str(KINEGRAPH), "replay", f"{name}.yaml", "real.mcap", "-o", "s", "-q"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "s"


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("real")
    recording(folder / "real.mcap")
    return made(folder, GRAPH, "real")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture(scope="module")
def shown(walked: Path) -> Shown:
    return Shown(walked)


@pytest.fixture(scope="module")
def opened(walked: Path, browser: LiveBrowser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with page_process(tmp_path_factory.mktemp("view"), "view", walked) as process:
        yield browser.open(process.url, 1400, 4000)


@pytest.fixture
def page(opened: LiveBrowser) -> LiveBrowser:
    """The recording as it opens: the first two seconds."""
    opened.value("window.before = true; location.reload()")
    opened.wait("!window.before && document.body.dataset.state === 'recording'")
    opened.wait("+document.querySelector('.signal')?.dataset.points > 1900")
    light(opened)
    opened.wait("+document.body.dataset.drawn > 5")
    return opened


def shades(page: LiveBrowser) -> list[str]:
    return list(page.value(f"({SHADES})"))


def box_of(page: LiveBrowser, panel: str) -> tuple[float, float, float, float]:
    """Where within its canvas a chart draws: left, top, width, height."""
    found = page.value(
        f"((a, b) => [a.x - b.x, a.y - b.y, a.width, a.height])(...['.u-over', 'canvas'].map(s => "
        f"document.querySelector(`[aria-label={json.dumps(panel)}] ${{s}}`).getBoundingClientRect()))"
    )
    return tuple(found)


def covered(time: Array, values: Samples, begin: float, pixels: int) -> tuple[Samples, Samples]:
    """The least and the greatest value of a line through samples, over each column of pixels."""
    fine = np.linspace(0, SPAN_S, 16 * pixels + 1)
    drawn = np.interp(fine, time - begin, values)
    parts = [
        np.r_[drawn[16 * k : 16 * k + 17], values[(time - begin >= fine[16 * k]) & (time - begin <= fine[16 * k + 16])]]
        for k in range(pixels)
    ]
    return np.array([p.min() for p in parts]), np.array([p.max() for p in parts])


def test_every_muscles_line_covers_in_each_column_what_it_reached_then(page: LiveBrowser, shown: Shown) -> None:
    time, data = shown.streams["treadmill.emg"]
    at = (time - shown.begin) / NS
    left, top, width, height = box_of(page, "raw EMG")
    lane, names = height / data.shape[1], shown.specs["treadmill.emg"].channels
    assert len(names) == 13
    written = np.array(page.like('[aria-label="raw EMG"] canvas', "dim", within=60))
    assert (written[:, 1] > top + height + 8).sum() > 100, "no time stands below"
    assert (written[:, 0] < left - 60).sum() > 13 * 20, "names and units are beside the lines"
    assert page.value("document.querySelector('.signal').dataset.labels").count(" µV") == 13
    seen = at <= SPAN_S + 1e-3
    for c in range(len(names)):
        values = data[seen, c].astype(float)
        low, high = covered(at[seen], values, 0.0, int(width))
        middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
        zero, factor = top + (c + 0.5) * lane, 0.46 * lane / half
        pixels = np.array(page.like('[aria-label="raw EMG"] canvas', shades(page)[c % 12], within=60))
        pixels = pixels[abs(pixels[:, 1] + 0.5 - zero) < lane / 2]
        columns = np.arange(2, int(width) - 2)
        ends = [pixels[pixels[:, 0] == round(left) + k, 1] for k in columns]
        there = np.array([len(e) > 0 for e in ends])
        assert there.mean() > 0.98, (names[c], "columns are empty")
        upper = np.array([e.min() if len(e) else np.nan for e in ends])
        lower = np.array([e.max() + 1 if len(e) else np.nan for e in ends])
        off = np.r_[
            upper - (zero - (high[columns] - middle) * factor), lower - (zero - (low[columns] - middle) * factor)
        ]
        assert np.nanpercentile(abs(off), 95) < 2, (names[c], np.nanpercentile(abs(off), [50, 95, 100]))


def loudest(level: Samples) -> int:
    """The bin with the largest value, the first one (0 Hz) apart."""
    return int(np.unravel_index(level[1:].argmax(), level[1:].shape)[0]) + 1


def test_a_spectrum_is_welchs_of_the_muscles(page: LiveBrowser, shown: Shown) -> None:
    choose(page, '[aria-label="raw EMG"]', "view", "spectrum")
    page.wait("+document.querySelector('.signal').dataset.peak > 0")
    time, data = shown.streams["treadmill.emg"]
    rows = data[(time - shown.begin) / NS <= SPAN_S].astype(float)
    size = min(1024, 1 << round(np.log2(len(rows) / 4)))
    _, density = welch(rows, 1000.0, "hann", size, axis=0, detrend="constant")
    level = 10 * np.log10(density)
    most = np.ceil(level.max() / 10) * 10
    least = max(most - 80, np.floor(level.min() / 10) * 10)
    page.value("[...document.querySelectorAll('.signal canvas')].at(-1).id = 'analysis'")
    width, height = page.value("(c => [c.width, c.height])(document.getElementById('analysis'))")
    reported = float(page.value("document.querySelector('.signal').dataset.peak"))
    assert abs(reported - loudest(level) * 1000 / size) < 0.01
    found = np.array(page.like("#analysis", shades(page)[12 % 12], within=60))  # the last line lies over the others
    x = FIRST + (width - FIRST - 8) * np.arange(len(level)) / (len(level) - 1)
    y = 6 + (height - 26) * (1 - np.maximum(0, (level[:, 12] - least) / (most - least)))
    reach = [np.hypot(found[:, 0] + 0.5 - a, found[:, 1] + 0.5 - b).min() for a, b in zip(x, y, strict=True)]
    assert np.percentile(reach, 95) < 2, np.percentile(reach, [50, 95, 100])


def test_a_spectrogram_has_the_colours_of_its_densities(page: LiveBrowser, shown: Shown) -> None:
    muscle = shown.specs["treadmill.emg"].channels.index("GM")
    choose(page, '[aria-label="raw EMG"]', "view", "spectrogram")
    choose(page, '[aria-label="raw EMG"]', "channel", muscle)
    page.wait(
        "+document.querySelector('.signal').dataset.peak > 0 && document.querySelector('.signal').dataset.view === 'spectrogram'"
    )
    time, data = shown.streams["treadmill.emg"]
    rows = data[(time - shown.begin) / NS <= SPAN_S, muscle].astype(float)
    _, at, density = spectrogram(rows, 1000.0, "hann", 256, 192, detrend="constant")
    level = 10 * np.log10(density)
    share = np.clip(1 - (level.max() - level) / 80, 0, 1)
    page.value("[...document.querySelectorAll('.signal canvas')].at(-1).id = 'analysis'")
    page.wait(f"Math.abs(document.querySelector('.signal').dataset.peak - {loudest(level) * 1000 / 256}) < .01")
    width, height = page.value("(c => [c.width, c.height])(document.getElementById('analysis'))")
    pixels = page.value(
        "(c => Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data))(document.getElementById('analysis'))"
    )
    image = np.array(pixels, np.uint8).reshape(height, width, 4).astype(int)
    x = (FIRST + (width - FIRST - 8) * at / SPAN_S).astype(int)
    bins = np.arange(2, len(level) - 2)
    y = (4 + (height - 24) * (1 - (bins + 0.5) / len(level))).astype(int)
    green = image[y[:, None], x[None], 1]  # of the colours, green grows all the way
    order = np.argsort(share[bins], axis=None)
    assert np.mean(np.diff(green.ravel()[order].astype(float)) < -3) < 0.01, "what is louder is not lighter"
    k, w = np.unravel_index(share[bins].argmax(), green.shape)
    assert np.abs(image[y[k], x[w], :3] - LIGHTEST).max() < 6


def test_touch_downs_stand_where_they_were_and_in_the_table(page: LiveBrowser, shown: Shown) -> None:
    seek_by_tenths(page, 3.0)
    onset = (shown.streams["treadmill.touchdown"][1]["onset"] - shown.begin) / NS
    inside = onset[(onset >= 2) & (onset <= 4)]
    assert len(inside) == 2
    page.wait(f"document.querySelector('[aria-label=touch-downs]').dataset.events === '{len(inside)}'")
    width = page.value("document.querySelector('[aria-label=touch-downs] canvas').width")
    bars = np.unique(
        [x for x, y in page.like("[aria-label=touch-downs] canvas", shades(page)[0], within=1) if 8 < y < 14]
    )
    expected = 118 + (inside - 2) / SPAN_S * (width - 118)
    assert all(np.abs(bars - x).min() < 2 for x in expected) and all(np.abs(expected - x).min() < 3 for x in bars)
    reported = page.value("[...document.querySelectorAll('.table tbody tr')].map(r => r.cells[0].textContent)")
    seconds = [float(text[-6:]) for text in reported]
    before = onset[onset <= 3.0][::-1]
    assert np.allclose(seconds, (shown.begin / NS % 60 + before) % 60, atol=2e-3)


def seek_by_tenths(page: LiveBrowser, seconds: float, span_s: float = SPAN_S) -> None:
    """Show so much around a moment, which is a whole number of steps from the beginning."""
    choose(page, "#controls", '"seconds shown"', round(span_s))
    page.value("document.activeElement.blur()")
    page.press("Home")
    page.wait("+document.body.dataset.looked === 0")
    page.press("ArrowRight", round(seconds / (span_s / 10)))
    page.wait(f"Math.abs(document.body.dataset.looked - {seconds}) < .001")


def test_an_avatar_stands_as_the_captured_body_did(page: LiveBrowser, shown: Shown) -> None:
    seek_by_tenths(page, 4.0)
    stamp, pose = shown.at("body.pose", 4.0)
    page.wait(
        f"Math.abs(document.querySelector('.avatar').dataset.at - {stamp}) < 1e-5 && document.querySelector('.avatar').dataset.bones"
    )
    body, rows = to_humanoid(JointTree.of(shown.specs["body.pose"]), pose[None].astype(float))
    avatar, moved = read_vrm(AVATAR), rows[0].copy()
    moved[:3] *= leg(avatar) / leg(body)
    bones = [BONES.index(bone) for bone in ("LeftHand", "RightHand", "Head")]
    expected = joints_of(avatar, moved[None])[1][0, bones]
    reported = page.value("document.querySelector('.avatar').dataset.bones")
    found = np.array([[float(v) for v in bone.split()] for bone in reported.split(", ")])
    assert np.abs(found - expected).max() < 0.01, (found, expected)
    assert page.colours(".avatar canvas") > 30


def test_how_alike_real_poses_are_is_what_was_recorded(page: LiveBrowser, shown: Shown) -> None:
    seek_by_tenths(page, 12.0, 60)
    time, rows = shown.streams["alike"]
    even_time, frames = shown.streams["even"]
    kept = frames[np.searchsorted(even_time, time)].reshape(len(time), -1).astype(float)
    last = int(np.searchsorted(time, shown.begin + 12 * NS, side="right"))
    page.wait(
        f"Math.abs(document.querySelector('.similarity').dataset.until - {(time[last - 1] - shown.begin) / NS}) < 1e-3"
    )
    n = int(page.value("document.querySelector('.similarity').dataset.size"))
    part = kept[last - n : last]
    distance = np.sqrt(((part[:, None] - part[None]) ** 2).mean(axis=2))
    assert np.allclose(rows[last - 1, : n - 1], distance[-1, -2::-1], rtol=1e-6)
    pixels = np.array(page.value(
        "(c => [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data])(document.querySelector('.similarity canvas'))"
    )).reshape(n, n, 4)  # fmt: skip
    green = pixels[..., 1].ravel()[np.argsort(distance, axis=None)].astype(int)
    assert n > 10 and (np.diff(green) <= 0).all(), "farther is not darker"
    assert tuple(pixels[np.unravel_index(distance.argmax(), distance.shape)][:3]) == DARKEST


@pytest.mark.parametrize("panel", ["plane", "grid"])
def test_a_real_pose_is_the_point_of_the_map_that_was_recorded(page: LiveBrowser, shown: Shown, panel: str) -> None:
    seek_by_tenths(page, 12.0, 60)
    place = shown.at({"plane": "plane.map", "grid": "grid.place"}[panel], 12.0)[1]
    facts = f"document.querySelector('section.map[aria-label={panel}]').dataset"
    page.wait(f"{facts}.place && Math.abs(JSON.parse({facts}.place)[0] - {place[0]}) < 1e-4 * (1 + {abs(place[0])})")
    assert np.allclose(json.loads(page.value(f"{facts}.place")), place[:2], rtol=1e-4, atol=1e-4)
    x, y = json.loads(page.value(f"{facts}.spot"))
    point = np.array(page.like(f"section.map[aria-label={panel}] canvas", shades(page)[1], within=30))
    assert np.hypot(*(np.median(point, axis=0) + 0.5 - [x, y])) < 2 and 80 < len(point) < 220, (
        "a disc of 7 pixels there"
    )
    if panel == "grid":
        assert page.value(f"{facts}.cells") == "20"
        assert len(page.like(f"section.map[aria-label={panel}] canvas", "rule", within=30)) > 1000, "around its cells"


def with_a_log(path: Path, target: Path) -> None:
    """The same recording, of a session that had to open a source again, and reported it three times."""
    with Recording.open(path) as source, Recorder(target, source.header, RecordingOptions(), wait=True) as recorder:
        numbers = {name: recorder.add_stream(name, stream.spec, "input") for name, stream in source.streams.items()}
        for k in range(3):
            recorder.log("source reopened", source.begin_of_inputs + k, level="warning", node="treadmill", opening=2)
        for sequence, name, chunk, arrival in source.inputs():
            recorder.write(numbers[name], chunk, arrival, sequence)


@pytest.mark.nightly
def test_a_replay_shows_its_rates_in_table_and_graph_and_what_the_session_told(
    walked: Path, browser: LiveBrowser
) -> None:
    folder = walked.parent
    with_a_log(folder / "real.mcap", folder / "told.mcap")
    with page_process(folder, "replay", "real.yaml", "told.mcap", "--speed", "0.5") as process:
        browser.open(process.url, 1400, 4000)
        browser.wait("document.querySelector('.state')?.dataset.rows > 8")
        rate = (
            "+[...document.querySelectorAll('.state tbody tr')].find(r => r.cells[0].textContent === 'treadmill.emg')"
            "?.cells[1].textContent"
        )
        browser.wait(f"(hz => hz > 300 && hz < 700)({rate})")  # 1000 a second at half its pace
        nodes = {"treadmill", "body", "performer", "pose", "even", "grid", "plane", "alike"}
        drawn = "[...document.querySelectorAll('.graph svg text')].map(t => t.textContent)"
        assert nodes <= set(browser.value(drawn))
        browser.wait(f"{drawn}.filter(t => /^[1-9][0-9.]*\\/s/.test(t)).length >= 8")
        reported = browser.value("document.querySelector('.log').textContent")
        assert "source reopened: node treadmill, opening 2 (3 times)" in reported
        assert reported.count("source reopened") == 1


NIGHT = """
name: night
record: [scorer]
page: {panels: [{kind: hypnogram, of: scorer, title: night, wide: 4}]}
nodes:
  wrist: {use: devices.recorded.RecordedStreams, path: real.mcap, of: wrist}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: wrist.counts, method: cole_kripke_actilife}
"""
MINUTES = 240


def test_a_hypnogram_of_a_persons_day_has_every_epoch_at_its_state(browser: LiveBrowser, tmp_path: Path) -> None:
    assert DATA
    day = arrays(DATA / "sleep/gt3x_day_actilife.npz")
    counts, asleep = day["axis1"][:MINUTES, None].astype(float), day["actilife_cole_kripke_sleep"][:MINUTES]
    meta = {"site": "wrist", "device": "actigraph"}
    spec = StreamSpec((1,), rate_hz=1 / 60, channels=("axis1",), units=("counts",), meta=meta)
    wrist = Series("wrist.counts", spec, grid(1 / 60, MINUTES, start_ns=START), counts)
    write_recording(tmp_path / "real.mcap", [wrist], {"graph": "", "session": {}})
    with page_process(tmp_path, "view", made(tmp_path, NIGHT, "night")) as process:
        browser.open(process.url, 1400, 900)
        browser.wait("document.body?.dataset.state === 'recording'")
        light(browser)
        choose = "(s => { s.value = '36000'; s.dispatchEvent(new Event('change')); })"
        browser.value(f"{choose}(document.querySelector('select[aria-label=\"seconds shown\"]'))")
        browser.wait(f"+document.querySelector('.hypnogram')?.dataset.final === {MINUTES}")
        line = np.array(browser.like(".hypnogram canvas", "accent", within=20))
        width = browser.value("document.querySelector('.hypnogram canvas').width")
        begin, minute = line[:, 0].min(), (width - 82) / 600  # what is left and right of the chart takes 82 px
        low, high = line[:, 1].max(), line[:, 1].min()
        at = np.floor(begin + minute * (np.arange(MINUTES) + 0.5))
        drawn = [np.abs(line[line[:, 0] == x][:, 1] - low).min(initial=high) < 3 for x in at]
        awake = [np.abs(line[line[:, 0] == x][:, 1] - high).min(initial=low) < 3 for x in at]
        changes = np.flatnonzero(np.diff(asleep)) + 1  # there a line leads from state to state
        plain = np.setdiff1d(np.arange(MINUTES), [changes - 1, changes])
        assert len(plain) > 150 and 0.2 < asleep[plain].mean() < 0.8
        assert np.array_equal(np.array(drawn)[plain], asleep[plain] == 1)
        assert np.array_equal(np.array(awake)[plain], asleep[plain] == 0)
