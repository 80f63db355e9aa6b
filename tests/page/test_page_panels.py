"""Every panel drawn in a real browser from a recording: what its canvas holds is what was recorded at that moment.

Once of a simulated session, and once of real recordings: EMG on a treadmill, motion capture, a galloping horse's mesh, and depth images
(rendered of a real motion).

Tests are in the order of their moments, to which each step draws every panel.

`KINEGRAPH_PICTURES=docs/pictures pytest -m nightly tests/page/test_page_panels.py -k pictures` makes those
of docs/use/page.md.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.operators.contacts.contacts import CONTACT
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.data.arrays import grid
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.convert_run import DATA, arrays
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process
from tests.support.real import DATA_MARKS

pytestmark = [needs_page, needs_browser, pytest.mark.timeout(280), pytest.mark.xdist_group("page panels")]

SECONDS = 20
GRAPH = """
name: panels
session: {subject: S01}
record: [envelope, cycles.cycles, cycles.closed, ensemble.mean, ensemble.sd, mixtures.modes, targets.targets, norms.low, norms.high,
  body.pose, steer.mesh, camera.depth]
page:
  panels:
    - {kind: cycles, of: [ensemble.mean, ensemble.sd, cycles.cycles, norms.low, norms.high], title: cycles, wide: 2}
    - {kind: cycles, of: [ensemble.mean, ensemble.sd, mixtures.modes, targets.targets], title: modes, wide: 2}
    - {kind: signal, of: treadmill.emg, title: raw EMG, wide: 2, window_s: 10}
    - {kind: scene, of: steer.mesh, title: a steered mesh}
    - {kind: scene, of: body.pose, title: a skeleton}
    - {kind: scene, of: performer.markers, title: markers}
    - {kind: scene, of: [performer.markers, body.pose], title: both}
    - {kind: frame, of: camera.depth, title: depth}
    - {kind: events, of: cycles.closed, title: cycles closed, wide: 2}
    - {kind: table, of: [cycles.closed, annotations], title: table}
nodes:
  envelope: {use: operators.emg.Envelope, from: treadmill.emg}
  cycles:
    use: operators.cycles.cycles.Cycles
    from: {signal: envelope, touchdown: treadmill.touchdown, liftoff: treadmill.liftoff}
  ensemble: {use: operators.cycles.statistics.ensemble.CycleEnsemble, from: {closed: cycles.closed, cycles: cycles.cycles}}
  mixtures:
    use: operators.emg.mixtures.PeakMixtures
    from: {maxima: cycles.maxima, closed: cycles.closed, cycles: cycles.cycles}
    fewest_cycles: 4
  targets:
    use: operators.cycles.statistics.cycle_targets.CycleTargets
    from: {closed: cycles.closed, cycles: cycles.cycles}
    targets: [{muscle: SO, from_pct: 20, to_pct: 60, low: 1, high: 1000}, {muscle: TA, from_pct: 90, to_pct: 10, low: 900, high: 1000}]
  norms: {use: operators.cycles.statistics.norms.NormativeBands, from: {closed: cycles.closed, cycles: cycles.cycles}, file: bands.csv}
"""
SIMULATED = """
  treadmill: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 20}
  performer: {use: devices.people.performer.Performer, realtime: false, duration_s: 20, noise_mm: 0}
  people: {use: devices.people.quadruped.TwoActors, realtime: false, duration_s: 20}
  camera: {use: devices.people.bedside.Bedside, width: 64, height: 48, fps: 1, bed_h: 0.01, evening_min: 2, morning_min: 0}
  body: {use: operators.pose.WholePose, from: performer.markers, up: y}
  legs:
    use: operators.steering.actors.Actors
    from: people
    limbs:
      {hoof_fl: [first.foot_l, first.hip], hoof_fr: [first.foot_r, first.hip], hoof_hl: [second.foot_l, second.hip],
       hoof_hr: [second.foot_r, second.hip]}
  steer: {use: operators.steering.SteerMesh, from: legs}
"""
REAL = "".join(
    f"  {name}: {{use: devices.recorded.RecordedStreams, path: real.mcap, of: {name}}}\n"
    for name in ("treadmill", "performer", "camera", "body", "steer")
)
MOMENTS = {
    "simulated": {"joints": 12, "mesh": (5, 9), "depth": 60, "cycles": 18, "chart": 10},
    "real": {"joints": 3, "mesh": (2, 3), "depth": 2, "cycles": 7, "chart": 5},
}
"""Seconds at which panels are looked at."""


def real(path: Path) -> None:
    """Real recordings, side by side in one."""
    assert DATA
    walk, mocap = arrays(DATA / "emg/emg_santuz_tw12.npz"), arrays(DATA / "segmentation/cmu86_full/86_01.npz")
    horse, depth = arrays(DATA / "steering/horse-gallop.npz"), arrays(DATA / "body/depth/exercise_front.npz")["depth"]
    bvh = {made.name.rpartition(".")[2]: made for made in read_bvh(DATA / "steering/cmu_131_01_scaled.bvh", "m")}

    def series(name: str, data: Array, rate: float, **spec: object) -> Series:
        made = StreamSpec(data.shape[1:], data.dtype, rate, **spec)  # type: ignore[arg-type]
        return Series(name, made, grid(rate, len(data)), data)

    def contacts(name: str, seconds: Array) -> Series:
        onset = np.round(seconds * NS).astype("<i8")
        spec = StreamSpec((), CONTACT, units=("ns",), meta={"side": "right"})
        return Series(f"treadmill.{name}", spec, onset, onset.view(CONTACT))

    mesh, pose = Topology(horse["vertices"].shape[1], horse["faces"], "horse"), bvh["pose"]
    gallop = horse["vertices"][np.arange(64) % 24].astype("<f8")
    kept = slice(0, 240)
    write_recording(
        path,
        [
            series("treadmill.emg", walk["emg_uV"], 1000.0, channels=tuple(walk["names"].tolist()), units=("uV",)),
            contacts("touchdown", walk["touchdown_s"]),
            contacts("liftoff", walk["liftoff_s"]),
            series("performer.markers", mocap["joints_cm"][kept], 30.0, channels=tuple(mocap["joint_names"].tolist()), units=("cm",)),
            series("camera.depth", depth, 30.0, units=("mm",), meta={"invalid": 0}),
            Series("body.pose", pose.spec, pose.time, pose.data),
            Series("steer.mesh", mesh.spec(12.0), grid(12.0, len(gallop)), gallop),
        ],
        {"graph": "", "session": {}},
    )  # fmt: skip


@pytest.fixture(scope="module", params=["simulated", pytest.param("real", marks=DATA_MARKS)])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def at(kind: str) -> dict[str, Any]:
    return MOMENTS[kind]


@pytest.fixture(scope="module")
def recorded(kind: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("panels")
    (folder / "panels.yaml").write_text(GRAPH + (SIMULATED if kind == "simulated" else REAL))
    (folder / "bands.csv").write_text("muscle,cycle_pct,low [uV],high [uV]\nTA,0,5,30\nSO,0,5,30\n")
    command = ["run", "panels.yaml", "--view", "none", "-o", "s"]
    if kind == "real":
        real(folder / "real.mcap")
        command = ["replay", "panels.yaml", "real.mcap", "-o", "s", "-q"]
    done = subprocess.run([KINEGRAPH, *command], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "s"


@pytest.fixture(scope="module")
def opened(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    """The recording, open in a browser, and read to its end."""
    folder = tmp_path_factory.mktemp("browser")
    with page_process(folder, "view", recorded) as process, live_browser(folder) as browser:
        browser.open(process.url, 1400, 5000)
        browser.wait("document.body.dataset.state === 'recording' && +document.body.dataset.drawn > 3")
        yield browser


@pytest.fixture
def page(opened: LiveBrowser) -> Iterator[LiveBrowser]:
    opened.complaints.clear()
    yield opened
    assert opened.complaints == []


class Shown:
    """What the recording holds, to compare with what the page shows: `begin` is its first stamp (ns)."""

    def __init__(self, path: Path) -> None:
        with Recording.open(path) as recording:
            self.begin = min(s.first for s in recording.streams.values() if s.first is not None)
            self.specs = {name: stream.spec for name, stream in recording.streams.items()}
            self.streams = {name: recording.read(name) for name in recording.streams}

    def at(self, stream: str, seconds: float) -> tuple[float, Array]:
        """A stream's last sample at a moment, and its stamp (s)."""
        time, data = self.streams[stream]
        i = int(np.searchsorted(time, self.begin + round(seconds * NS), side="right")) - 1
        return (int(time[i]) - self.begin) / NS, np.asarray(data[i])


@pytest.fixture(scope="module")
def shown(recorded: Path) -> Shown:
    return Shown(recorded)


def seek(page: LiveBrowser, seconds: int) -> None:
    """Move to a whole second by the keys (a step is a tenth of what is shown), and wait until all panels show it.

    Onwards where possible, otherwise from the beginning: each step draws every panel.
    """
    at = float(page.value("+document.body.dataset.looked || -.5"))
    if at > seconds or abs(at - round(at)) > 0.001:
        page.press("Home")
        page.wait("+document.body.dataset.looked === 0")
        at = 0.0
    at = round(at)
    while at < seconds:  # what is asked for is answered in order; few are asked for at once
        steps = min(10, seconds - at)
        page.press("ArrowRight", steps)
        at += steps
        page.wait(f"Math.abs(document.body.dataset.looked - {at}) < .001")


def is_at(page: LiveBrowser, panel: str, stamp: float) -> None:
    """A panel shows the sample of this stamp (s)."""
    assert abs(float(page.value(f"""document.querySelector('[aria-label="{panel}"]').dataset.at""")) - stamp) < 1e-5


def canvas(panel: str) -> str:
    return f'[aria-label="{panel}"] canvas'


def in_view(page: LiveBrowser, panel: str, points: Array) -> Array:
    """Where a scene's names stand in its panel, (n, 2) pixels; NaN where one is hidden."""
    script = f"""[...document.querySelectorAll('[aria-label="{panel}"] .name')].map(e => e.hidden ? [NaN, NaN] :
      e.style.transform.match(/-?[\\d.]+/g).map(Number))"""
    return np.array([[v if v is not None else np.nan for v in row] for row in page.value(script)], float)


def test_a_mesh_is_shaded_and_moves(page: LiveBrowser, shown: Shown, at: dict[str, Any]) -> None:
    drawn = []
    for t in (*at["mesh"], at["mesh"][0]):
        seek(page, t)
        is_at(page, "a steered mesh", shown.at("steer.mesh", t)[0])
        drawn.append({tuple(p) for p in page.like(canvas("a steered mesh"), "#8fa8c8", within=140)})
        assert page.colours(canvas("a steered mesh")) > 30
    assert len(drawn[0]) > 3000
    assert drawn[0] == drawn[2] != drawn[1]
    assert page.value("document.querySelector('[aria-label=\"a steered mesh\"]').dataset.points") == str(
        shown.specs["steer.mesh"].shape[0]
    )


def test_markers_stand_where_they_were_and_a_hidden_one_is_not_drawn(
    page: LiveBrowser, shown: Shown, kind: str
) -> None:
    last = int(shown.streams["performer.markers"][0][-1] - shown.begin) // NS
    hidden = [t for t in range(1, last) if np.isnan(shown.at("performer.markers", t)[1]).any()]
    seen = [t for t in range(1, last) if not np.isnan(shown.at("performer.markers", t)[1]).any()]
    assert hidden or kind == "real", "motion capture of this kind has every marker all the time"
    for t in (seen[0], *hidden[:1]):
        stamp, points = shown.at("performer.markers", t)
        seek(page, t)
        is_at(page, "markers", stamp)
        names = in_view(page, "markers", points)
        assert np.array_equal(np.isnan(names[:, 0]), np.isnan(points[:, 0]))
        pixels = np.array(page.like(canvas("markers"), "accent"))
        for x, y in names[~np.isnan(names[:, 0])]:  # a name stands 6 px to the right of its point and 8 above it
            assert np.hypot(pixels[:, 0] - (x - 6), pixels[:, 1] - (y + 8)).min() < 4
        reach = np.hypot(*(pixels[:, None] - (names[None] + [-6, 8])).transpose(2, 0, 1))
        assert (np.nanmin(reach, axis=1) < 8).all(), "something else is drawn"


@pytest.mark.parametrize("panel", ["markers", "a skeleton"])
@pytest.mark.nightly
def test_names_do_not_stand_over_one_another(page: LiveBrowser, panel: str, at: dict[str, Any]) -> None:
    seek(page, at["joints"])
    script = f"""[...document.querySelectorAll('[aria-label="{panel}"] .name')].filter(e => getComputedStyle(e).visibility === 'visible'
      && !e.hidden).map(e => (r => [r.left, r.top, r.right, r.bottom])(e.getBoundingClientRect()))"""
    boxes = np.array(page.value(script))
    assert len(boxes) > 5
    for i, (left, top, right, bottom) in enumerate(boxes):  # a pixel or two of a letter's box are empty
        others = np.delete(boxes, i, axis=0)
        over = (
            (others[:, 0] < right - 2)
            & (others[:, 2] > left + 2)
            & (others[:, 1] < bottom - 4)
            & (others[:, 3] > top + 4)
        )
        assert not over.any()


def test_a_skeleton_stands_where_its_joints_are(page: LiveBrowser, shown: Shown, at: dict[str, Any]) -> None:
    tree = JointTree.of(shown.specs["body.pose"])
    stamp, pose = shown.at("body.pose", at["joints"])
    seek(page, at["joints"])
    is_at(page, "a skeleton", stamp)
    names = in_view(page, "a skeleton", pose) + np.array([-6, 8])
    joints = joints_of(tree, pose[None])[1][0]
    assert names.shape == (len(tree.joints), 2)
    # seen in perspective, straight lines stay straight: the same projection must fit all joints
    seen = np.column_stack([joints, np.ones(len(joints))])
    zero = np.zeros_like(seen)
    rows = np.vstack([np.hstack([seen, zero, -names[:, :1] * seen]), np.hstack([zero, seen, -names[:, 1:] * seen])])
    spread = np.linalg.svd(rows)[1]
    assert spread[-1] < 1e-3 * spread[-2], "the joints are not a projection of the recorded ones"
    bones = np.array(page.like(canvas("a skeleton"), "dim", within=90))
    for joint, parent in enumerate(tree.parents):
        a, b = names[joint], names[parent]
        if parent >= 0 and np.hypot(*(a - b)) > 25:
            assert np.hypot(*(bones - (a + b) / 2).T).min() < 4, (tree.joints[joint], "no line to its parent")


def test_cycles_have_their_mean_band_and_last_cycle(page: LiveBrowser, shown: Shown, at: dict[str, Any]) -> None:
    stamp, _ = shown.at("ensemble.mean", at["cycles"])
    seek(page, at["cycles"])
    is_at(page, "cycles", stamp)
    names = shown.specs["ensemble.mean"].channels
    width = page.value(f"document.querySelector({canvas('cycles')!r}).width")
    shape = "document.querySelector('[aria-label=\"cycles\"]').dataset"
    columns, tall = (int(page.value(f"{shape}.{name}")) for name in ("columns", "cell"))
    assert columns <= min(len(names), width // 150)
    cell = width / columns
    middle = (tall + 18 - 6) / 2
    band = np.array(page.like(canvas("cycles"), "rule", within=10))
    for c, _ in enumerate(names):
        left, top = c % columns * cell, c // columns * tall
        inside = band[
            (abs(band[:, 0] - left - cell / 2) < cell / 2 - 8) & (abs(band[:, 1] - top - middle) < (tall - 24) / 2)
        ]
        assert len(inside) > 60, (names[c], "no band")
        line = np.array(page.like(canvas("cycles"), page.value(f"({SHADES})[{c} % 12]"), within=60))
        line = line[(abs(line[:, 0] - left - cell / 2) < cell / 2) & (abs(line[:, 1] - top - middle) < tall / 2 - 9)]
        # not the tail of the label's µ above it
        _, last = shown.at("cycles.cycles", at["cycles"])
        peak = np.argmax(last[:, c]) / (len(last) - 1)
        highest = line[line[:, 1] <= line[:, 1].min() + tall / 30, 0]  # real muscles have plateaus
        assert abs(highest - (left + 6 + peak * (cell - 12))).min() < 6, (names[c], "the last cycle is not that one")


def test_modes_are_ellipses_where_they_are_and_targets_are_boxes(
    page: LiveBrowser, shown: Shown, at: dict[str, Any]
) -> None:
    stamp, _ = shown.at("ensemble.mean", at["cycles"])
    seek(page, at["cycles"])
    is_at(page, "modes", stamp)
    names = shown.specs["ensemble.mean"].channels
    times, modes = shown.streams["mixtures.modes"]
    seen = modes[times <= shown.begin + at["cycles"] * NS]
    last = {name: seen[(seen["name"] == name)] for name in names}
    last = {name: rows[rows["number"] == rows["number"].max()] for name, rows in last.items() if len(rows)}
    assert last, "no mixture to be shown"
    box = "document.querySelector('[aria-label=\"modes\"]').dataset"
    assert page.value(f"{box}.ellipses") == "0", "they are drawn where they are wanted"
    page.value("document.querySelector('[aria-label=\"modes\"] header button[aria-pressed]').click()")
    page.wait(f"{box}.ellipses !== '0'")
    assert page.value(f"{box}.ellipses") == str(sum(map(len, last.values())))
    assert page.value(f"{box}.targets") == "2"
    assert page.value("document.querySelector('[aria-label=\"cycles\"]').dataset.norms") == "2", (
        "of TA and SO there are bands"
    )
    width = page.value(f"document.querySelector({canvas('modes')!r}).width")
    columns, tall = (int(page.value(f"{box}.{name}")) for name in ("columns", "cell"))
    cell = width / columns
    ink = np.array(page.like(canvas("modes"), "ink", within=90))
    for name, rows in last.items():
        c = names.index(name)
        left, top = c % columns * cell + 6, c // columns * tall + 18
        inside = ink[
            (abs(ink[:, 0] - left - cell / 2 + 6) < cell / 2 - 6)
            & (abs(ink[:, 1] - top - (tall - 24) / 2) < (tall - 24) / 2)
        ]
        narrow = rows[(rows["sd_pct"] < 8) & (rows["place_pct"] > 20) & (rows["place_pct"] < 80)]
        for row in narrow:
            at = left + (cell - 12) * row["place_pct"] / 99
            reach = 2 * (cell - 12) * row["sd_pct"] / 99
            assert (abs(inside[:, 0] - at) <= reach + 3).any(), (name, row, "no ellipse there")
    green = page.like(canvas("modes"), "#12924a", within=6)
    red = page.like(canvas("modes"), "#d6202e", within=6)
    assert len(green) > 20, "soleus is within its band"
    assert not red, "a band far above the curve is above the box"


SHADES = """["#1f5fa8", "#b0481c", "#2a7d3f", "#8a3f98", "#8a6a00", "#b22a5b", "#0f7c85", "#5b5bd6", "#6b4f2e", "#4d6b00", "#a3333d",
"#42596e"]"""


def test_a_strip_chart_has_a_line_for_each_channel_over_the_whole_span(
    page: LiveBrowser, shown: Shown, at: dict[str, Any]
) -> None:
    seek(page, at["chart"])
    page.value("document.documentElement.dataset.theme = 'light'")
    time, data = shown.streams["treadmill.emg"]
    there = (time[[0, -1]] - shown.begin) / NS - at["chart"]
    share = float(np.diff(np.clip(there, -5, 5))[0]) / 10
    width = page.value(f"document.querySelector({canvas('raw EMG')!r}).width")
    for c in range(data.shape[1]):
        line = np.array(page.like(canvas("raw EMG"), page.value(f"({SHADES})[{c} % 12]"), within=60))
        columns = np.unique(line[:, 0])
        assert len(columns) > 0.8 * share * (width - 130), (c, "the line does not fill its lane")


def test_events_are_bars_from_onset_to_end(page: LiveBrowser, shown: Shown, at: dict[str, Any]) -> None:
    seek(page, at["chart"])
    _, data = shown.streams["cycles.closed"]
    begins = at["chart"] - 5
    inside = (data["end"] > shown.begin + begins * NS) & (data["onset"] < shown.begin + (begins + 10) * NS)
    assert page.value("document.querySelector('[aria-label=\"cycles closed\"]').dataset.events") == str(inside.sum())
    width = page.value(f"document.querySelector({canvas('cycles closed')!r}).width")
    bars = np.array(
        [x for x, y in page.like(canvas("cycles closed"), page.value(f"({SHADES})[0]"), within=1) if y == 10]
    )
    onsets, ends = ((data[name][inside] - shown.begin) / NS - begins for name in ("onset", "end"))
    assert (
        len(bars) > 0.95 * np.clip(ends, 0, 10).max() / 10 * (width - 118) - np.clip(onsets, 0, 10).min() / 10 * width
    )
    for x in 118 + onsets[onsets > 0.1] / 10 * (width - 118):  # between two bars a pixel is left free
        assert {*range(round(x) - 2, round(x) + 2)} - {*bars.tolist()}, "no bar begins there"


def test_a_frame_has_its_pixels_and_those_without_a_value_are_hatched(
    page: LiveBrowser, shown: Shown, at: dict[str, Any]
) -> None:
    stamp, frame = shown.at("camera.depth", at["depth"])
    seek(page, at["depth"])
    is_at(page, "depth", stamp)
    pixels = np.array(page.value(PIXELS), np.uint8).reshape(*frame.shape, 4)[..., :3].astype(int)
    empty = (pixels[..., 0] == pixels[..., 1]) & (pixels[..., 1] == pixels[..., 2])
    assert np.array_equal(empty, frame == 0)
    near, far = (np.argwhere(frame == v)[0] for v in (frame[frame > 0].min(), frame.max()))
    assert tuple(pixels[*near]) == (68, 1, 84) and tuple(pixels[*far]) == (253, 231, 37)
    order = np.argsort(frame[~empty], kind="stable")
    green = pixels[~empty][order][:, 1]
    assert (np.diff(green) >= 0).all(), "farther is not lighter"
    reported = page.value("document.querySelector('[aria-label=\"depth\"] .legend').textContent")
    assert f"{frame[frame > 0].min() / 1000:.2f}" in reported and " m" in reported


PIXELS = """(c => [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data])(
  document.querySelector('[aria-label="depth"] canvas'))"""


PICTURES = {"a steered mesh": 10, "both": 12, "cycles": 18, "depth": 60}


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["simulated"], indirect=True)
@pytest.mark.parametrize(("panel", "moment"), PICTURES.items())
def test_pictures(page: LiveBrowser, shown: Shown, panel: str, moment: int, tmp_path: Path) -> None:
    of = page.value(f"document.querySelector('[aria-label=\"{panel}\"]').dataset.of").split()
    seek(page, moment)
    is_at(page, panel, max(shown.at(stream, moment)[0] for stream in of))
    picture = tmp_path / f"panel-{panel.split()[-1]}.png"
    page.picture(picture, f'[aria-label="{panel}"]')
    assert picture.stat().st_size > 2000


def test_a_scene_fills_its_panel(page: LiveBrowser) -> None:
    script = """[...document.querySelectorAll('.scene .body')].map(body => [body.clientWidth, body.clientHeight,
      body.firstChild.clientWidth, body.firstChild.clientHeight])"""
    for width, height, of_canvas, high in page.value(script):
        assert (of_canvas, high) == (width, height) and height >= 300
