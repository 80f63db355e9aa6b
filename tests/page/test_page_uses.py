"""The pages of the three uses in a real browser: the night as it grows, both legs and their stages, repetitions in their clusters."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.actigraph import Actigraph, ActigraphNight
from kinegraph.stream.chunk import NS
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

pytestmark = [pytest.mark.nightly, needs_page, needs_browser, pytest.mark.timeout(280)]

SHADES = ("#1f5fa8", "#b0481c", "#2a7d3f", "#8a3f98", "#8a6a00", "#b22a5b", "#0f7c85", "#5b5bd6")
CALM = ("#1f5fa8", "#2a7d3f", "#8a3f98", "#0f7c85", "#5b5bd6", "#8a6a00")
"""Shades of what happened: red is for alarms."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


def made(folder: Path, *arguments: object) -> None:
    """What `kinegraph run` makes of a graph, in the folder `s`."""
    command = [str(KINEGRAPH), "run", *map(str, arguments), "--view", "none", "-o", "s"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# the night -----------------------------------------------------------------------------------------------------------

NIGHT = """
name: night
record: [scorer]
page:
  panels:
    - {kind: hypnogram, of: scorer, title: the night, wide: 4}
nodes:
  wrist: {use: devices.people.actigraph.Actigraph}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: wrist.activity}
"""
EPOCH_S = 30


def a_night(folder: Path) -> None:
    """An hour and a half of counts, which came as they were measured, and in `s` what the scorer makes of them."""
    night = Actigraph(evening_h=0.2, bed_h=1.2, morning_h=0.1, seed=3)
    counts = ActigraphNight(night).counts
    time = 1_700_000_010 * NS + np.arange(len(counts)) * EPOCH_S * NS
    series = Series("wrist.activity", night.specs()["activity"], time, np.asarray(counts, float).reshape(-1, 1))
    write_recording(folder / "night.mcap", [series], {})
    (folder / "night.yaml").write_text(NIGHT)
    command = [KINEGRAPH, "replay", "night.yaml", "night.mcap", "-q", "--out", "s"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def scored(recording: Path, until_s: float) -> tuple[dict[int, str], dict[int, str]]:
    """The states of the epochs that were final, and of those that were provisional, at a moment: by onset (ns)."""
    with Recording.open(recording) as opened:
        begin = min(s.first for s in opened.streams.values() if s.first is not None)
        time, rows = opened.read("scorer")
    known = rows[time <= begin + until_s * NS]
    final = {int(r["onset"]): str(r["state"]) for r in known if r["final"]}
    return final, {int(r["onset"]): str(r["state"]) for r in known if int(r["onset"]) not in final}


def jump(browser: LiveBrowser, to_s: float) -> float:
    """Move a replay that stands still; where it then stands (s)."""
    browser.value(
        f"(s => {{ s.value = '{to_s}'; s.dispatchEvent(new Event('change')); }})(document.querySelector('input[type=range]'))"
    )
    return float(browser.wait(f"(t => t >= {to_s} - {EPOCH_S} && t)(+document.body.dataset.replayed)"))


def test_the_night_grows_and_what_is_provisional_is_told_from_what_is_final(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    a_night(tmp_path)
    with page_process(tmp_path, "replay", "night.yaml", "night.mcap", "-q", "--speed", "0.1") as process:
        browser.open(process.url)
        browser.wait("document.querySelector('.hypnogram') && document.body.dataset.pace")
        browser.value("document.documentElement.dataset.theme = 'light'")
        browser.type(" ")
        browser.wait("document.body.dataset.pace === '0'")
        counts = []
        for to_s in (2415, 4515):
            final, provisional = scored(tmp_path / "s", jump(browser, to_s))
            assert final and provisional
            browser.wait(
                f"(d => d.final === '{len(final)}' && d.provisional === '{len(provisional)}')"
                "(document.querySelector('.hypnogram').dataset)"
            )
            counts.append(len(final))
            lines = np.array(browser.like(".hypnogram canvas", "accent", within=20))
            outlines = np.array(browser.like(".hypnogram canvas", "warn", within=60))
            width = browser.value("document.querySelector('.hypnogram canvas').width")
            first, last = min(final), max([*final, *provisional]) + 30 * NS
            edge = 74 + (width - 82) * (max(final) + 30 * NS - first) / max(last - first, 600 * NS)
            assert lines[:, 0].max() <= edge + 2 and outlines[:, 0].min() >= edge - 2, (
                "final to the left, the rest after it"
            )
            for state in {*final.values()}:  # each state has its height, waking above sleep
                columns = [
                    74 + (width - 82) * (on + 15 * NS - first) / (last - first) for on, s in final.items() if s == state
                ]
                heights = [lines[abs(lines[:, 0] - x) < 1][:, 1].mean() for x in columns]
                assert np.ptp(heights) < 40, (state, "not at one height")
        assert counts[0] < counts[1]
        note = browser.value("document.querySelector('.hypnogram output').textContent")
        assert "final until" in note and "provisional" in note
        browser.picture(tmp_path / "page-night.png", ".hypnogram")
        assert browser.complaints == []


def test_the_shipped_bedside_graph_draws_its_night_and_offers_no_image(browser: LiveBrowser, tmp_path: Path) -> None:
    with page_process(tmp_path, "run", "bedside_simulated", "--view", "none", "-o", "s") as process:
        browser.open(process.url)
        browser.value("document.documentElement.dataset.theme = 'light'")
        night = "document.querySelector('.hypnogram').dataset"
        browser.wait("!!document.querySelector('.hypnogram')")
        first = int(browser.wait(f"+{night}.provisional > 0 && +{night}.final > 20 && +{night}.final"))
        browser.wait(f"+{night}.final > {first}")
        assert len(browser.like(".hypnogram canvas", "accent", within=20)) > 20
        assert browser.like(".hypnogram canvas", "warn", within=60)
        browser.wait("document.querySelector('.signal')?.dataset.points > 10")
        assert browser.value("document.querySelectorAll('.frame').length") == 0
        browser.picture(tmp_path / "page-bedside.png")
        assert browser.complaints == []
        assert process.stop() == 0


# both legs -----------------------------------------------------------------------------------------------------------


LEGS = """
name: legs
record: [stages.stages, stages.closed, ensemble.mean]
page:
  panels:
    - {kind: cycles, of: [ensemble.mean, ensemble.sd, cycles.cycles], title: cycles, wide: 2}
    - {kind: table, of: stages.stages}
    - {kind: log}
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, legs: both, muscles: [RF, BF, TA, SO], left_share: 0.8}
  feet:
    use: operators.contacts.limb_contacts.LimbContacts
    from: treadmill.force
    detector: force
    limbs: {left: {channels: [Fz_left], other: [Fz_right]}, right: {channels: [Fz_right], other: [Fz_left]}}
  envelope: {use: operators.emg.Envelope, from: treadmill.emg}
  cycles:
    use: operators.cycles.limb_cycles.LimbCycles
    from: {signal: envelope, touchdown: feet.touchdown, liftoff: feet.liftoff}
    limbs: {left: "L_*", right: "R_*"}
  annotations: {use: stream.manual.Annotations, input_lag_s: 0.05}
  stages:
    use: operators.cycles.stages.Stages
    from: {signal: envelope, annotations: annotations, closed: cycles.closed}
    protocol: [{stage: warm-up, for_s: 600}]
  ensemble: {use: operators.cycles.statistics.ensemble.CycleEnsemble, from: {closed: stages.closed, cycles: cycles.cycles}}
"""


def test_left_stands_beside_right_and_stages_begin_and_end_from_the_page(browser: LiveBrowser, tmp_path: Path) -> None:
    (tmp_path / "legs.yaml").write_text(LEGS)
    with page_process(tmp_path, "run", "legs.yaml", "--view", "none", "-o", "s") as process:
        browser.open(process.url)
        browser.value("document.documentElement.dataset.theme = 'light'")
        browser.wait("document.querySelector('.cycles')?.dataset.cycles > 4")
        unfold(browser)
        words = "[...document.querySelectorAll('#controls .word button, #controls button.word')]"
        browser.value(f"{words}.find(b => b.textContent === 'end stage').click()")
        browser.wait("document.querySelector('.log').textContent.includes('end stage')")
        browser.value(
            "(i => { i.closest('details')?.setAttribute('open', ''); i.focus(); })"
            "(document.querySelector('#controls input[aria-label=stage]'))"
        )
        browser.type("uphill\r")
        browser.wait("document.querySelector('.table table').textContent.includes('uphill')")
        before = browser.value("document.querySelector('.cycles').dataset.cycles")
        beside(browser)
        scales = json.loads(browser.value("document.querySelector('.cycles').dataset.scales"))
        assert scales[:4] == scales[4:] and len({most for _, most in scales}) == 4, (
            "left and right of a muscle share one"
        )
        assert {least for least, _ in scales} == {0}
        browser.wait(f"document.querySelector('.cycles').dataset.cycles > {before} + 5")
        browser.size(1280, 4000)
        browser.wait("innerWidth === 1280 && document.querySelector('.cycles canvas').width > 1000")
        browser.picture(tmp_path / "page-both-legs.png", ".cycles")
        assert browser.complaints == []
        assert process.stop() == 0
    with Recording.open(tmp_path / "s") as recording:
        stages = recording.read("stages.stages")[1]["stage"].tolist()
        closed = recording.read("stages.closed")[1]["stage"].tolist()
        reported = recording.read("annotations")[1]["text"].tolist()
    assert reported == ["end stage", "stage uphill"]
    assert stages == ["warm-up", "", "uphill"] and closed[-1] == "uphill"
    verify = [KINEGRAPH, "replay", "legs.yaml", "s", "--verify", "-q"]
    done = subprocess.run(verify, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "stages.stages: identical" in done.stdout + done.stderr


def unfold(browser: LiveBrowser) -> None:
    """Open what is folded into "signals", tables among it, on a screen on which all of it is in sight."""
    browser.size(1280, 4000)
    browser.value("document.querySelectorAll('.signals').forEach((d) => { d.open = true; })")


def beside(browser: LiveBrowser) -> None:
    """The cells of a wide panel and of a narrow one: a muscle's left, and its right to the right of it."""
    for width in (1280, 500):
        browser.size(width, 4000)
        browser.wait(f"document.querySelector('.cycles canvas').width < {width} && innerWidth === {width}")
        wide = browser.value("document.querySelector('.cycles canvas').width")
        columns = 4 if width > 600 else 2  # as large as leaves all of them in sight, a left one beside its right one
        cell, rows = wide / columns, -(-8 // columns)
        browser.wait(
            "(c => Number(c.dataset.cell) > 90 && c.querySelector('canvas').height === "
            f"{rows} * Number(c.dataset.cell))(document.querySelector('.cycles'))"
        )
        tall = int(browser.value("document.querySelector('.cycles').dataset.cell"))
        for leg, muscle in ((leg, muscle) for leg in (0, 1) for muscle in range(4)):
            line = np.array(browser.like(".cycles canvas", SHADES[4 * leg + muscle], within=40))
            place = 2 * muscle + leg
            left, top = place % columns * cell, place // columns * tall
            inside = (line[:, 0] >= left) & (line[:, 0] < left + cell) & (line[:, 1] >= top) & (line[:, 1] < top + tall)
            assert len(line) and inside.mean() > 0.6, (width, leg, muscle, "drawn elsewhere")


# segmentation --------------------------------------------------------------------------------------------------------


def test_repetitions_are_counted_activities_are_bars_and_clusters_have_colours(
    browser: LiveBrowser, tmp_path: Path
) -> None:
    made(
        tmp_path,
        "segment_mocap",
        "--set",
        "mocap.realtime=false",
        "--set",
        "mocap.duration_s=90",
        "--set",
        "report.path=r.html",
    )
    with Recording.open(tmp_path / "s") as recording:
        begin = min(s.first for s in recording.streams.values() if s.first is not None)
        end = max(s.last for s in recording.streams.values() if s.last is not None)
        _, activities = recording.read("segment.activity")
        _, primitives = recording.read("segment.primitive")
        _, counts = recording.read("segment.count")
    with page_process(tmp_path, "view", "s") as view:
        browser.open(view.url)
        browser.value("document.documentElement.dataset.theme = 'light'")
        browser.wait("document.body.dataset.looked >= 0")
        browser.value(
            "(s => { s.value = '300'; s.dispatchEvent(new Event('change')); })"
            "(document.querySelector('select[aria-label=\"seconds shown\"]'))"
        )
        browser.press("End")
        browser.wait(f"Math.abs(document.body.dataset.looked - {(end - begin) / NS}) < .01")
        bars = "document.querySelector('[aria-label=\"{}\"]').dataset.events"
        browser.wait(f"{bars.format('activities')} === '{len(activities)}'")
        browser.wait(f"{bars.format('repetitions by cluster')} === '{len(primitives)}'")
        clusters = {str(row["cluster"]) for row in primitives}
        seen = [s for s in CALM if len(browser.like('[aria-label="repetitions by cluster"] canvas', s, within=2)) > 8]
        assert len(clusters) > 1 and len(seen) >= min(len(clusters), len(CALM)), "a colour for each cluster"
        assert len(browser.like('[aria-label="activities"] canvas', SHADES[0], within=2)) > 8
        unfold(browser)
        browser.wait(f"document.querySelector('.table').dataset.rows === '{min(60, len(counts))}'")
        newest = browser.value(
            "(t => { const h = [...t.tHead.rows[0].cells].map(c => c.textContent);"
            "return Object.fromEntries([...t.tBodies[0].rows[0].cells].map((c, i) => [h[i], c.textContent])); })"
            "(document.querySelector('.table table'))"
        )
        assert int(newest["count"]) == int(counts[-1]["count"])
        browser.wait("+document.querySelector('.similarity').dataset.size > 10")
        browser.picture(tmp_path / "page-repetitions.png")
        assert browser.complaints == []
