"""Marks in a recording: made by a person who looks at it, kept beside it, seen again and in a replay; the recording stays as it is."""

from __future__ import annotations

import asyncio
import hashlib
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.page.marks import MAX_MARKS, Marks, shown_with
from kinegraph.devices.page.recorded.viewing import RecordingHub
from kinegraph.devices.page.transfer.wire import Mark
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

GRAPH = """
name: marked
record: [calf]
page: {panels: [{kind: signal, of: calf, wide: 2}, {kind: events, of: annotations, wide: 2}]}
nodes:
  annotations: {use: stream.manual.Annotations}
  board: {use: devices.people.treadmill.Treadmill}
  calf: {use: operators.filters.channels.Select, from: board.emg, channels: [GM, SO]}
"""


def contents(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.mcap")}


@needs_page
@needs_browser
@pytest.mark.timeout(280)
@pytest.mark.nightly
def test_a_moment_that_was_marked_in_a_recording_is_seen_again_and_in_its_replay(tmp_path: Path) -> None:
    (tmp_path / "marked.yaml").write_text(GRAPH)
    command = [KINEGRAPH, "run", "marked.yaml", "--for", "4", "--view", "none", "-o", "s"]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True).returncode == 0
    before = contents(tmp_path / "s")
    with live_browser(tmp_path) as browser:
        with page_process(tmp_path, "view", "s") as view:
            browser.open(view.url)
            at = mark(browser, "<b>swallowed</b>")
            assert browser.complaints == []
            assert view.stop() in (0, 130)
        assert contents(tmp_path / "s") == before
        stored = json.loads((tmp_path / "s" / "marks.json").read_text())["marks"]
        assert [m["text"] for m in stored] == ["<b>swallowed</b>"]
        with page_process(tmp_path, "view", "s") as view:
            browser.open(view.url)
            browser.wait("document.getElementById('line').dataset.marks === '1'")
        with page_process(tmp_path, "replay", "marked.yaml", "s", "--verify", "-q") as replay:
            browser.open(replay.url)
            browser.wait("document.querySelector('.events')?.dataset.events === '1'")
            assert float(browser.value("document.body.dataset.replayed")) > at - 1.5
            assert browser.complaints == []
            assert replay.process.wait(100) == 0
    assert contents(tmp_path / "s") == before


def mark(browser: LiveBrowser, text: str) -> float:
    """Move to the middle of a recording and mark it; where that is (s)."""
    browser.wait("document.body.dataset.looked >= 0 && document.querySelector('.signal')?.dataset.points > 0")
    browser.drag("#line canvas", 0.2, 0.5)
    at = browser.wait("(t => t > .5 && t)(+document.querySelector('#line canvas').getAttribute('aria-valuenow'))")
    browser.type("m")
    browser.wait("document.activeElement.getAttribute('aria-label') === 'annotation'")
    browser.type(text + "\r")
    browser.wait("document.getElementById('line').dataset.marks === '1'")
    return float(at)


def test_many_quick_marks_are_written_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signal = Series("a", StreamSpec((1,), rate_hz=1.0), NS * np.arange(1, 4), np.zeros((3, 1)))
    write_recording(tmp_path / "s.mcap", [signal], {"graph": ""})
    written: list[int] = []
    add = Marks.add

    def counted(marks: Marks, new: list[tuple[int, str]]) -> None:
        written.append(len(new))
        add(marks, new)

    monkeypatch.setattr(Marks, "add", counted)

    async def mark_quickly(hub: RecordingHub) -> None:
        client = hub.visitor()
        for k in range(3000):
            hub.take(client, Mark(f"{k}", k / 3000))
        await hub.close()

    with Recording.open(tmp_path / "s.mcap") as opened:
        asyncio.run(mark_quickly(RecordingHub(opened)))
    assert sum(written) == 3000 and len(written) <= 2
    assert len(Marks(tmp_path / "s.mcap").read()[0]) == 3000


def test_marks_beyond_the_limit_are_refused_and_the_others_kept(tmp_path: Path) -> None:
    marks = Marks(tmp_path)
    with pytest.raises(KinegraphError, match="takes no more"):
        marks.add([(k, "x") for k in range(MAX_MARKS + 1)])
    assert len(Marks(tmp_path).read()[0]) == MAX_MARKS


def test_marks_come_back_in_the_order_of_time(tmp_path: Path) -> None:
    marks = Marks(tmp_path)
    for onset, text in ((5, "later"), (3, "früher"), (5, "later")):
        marks.add([(onset, text)])
    time, data = Marks(tmp_path).read()
    assert time.tolist() == [3, 5, 5]
    assert data["text"].tolist() == ["früher", "later", "later"]
    assert len(Marks(tmp_path / "one.mcap").read()[0]) == 0
    assert Marks(tmp_path / "one.mcap").path.name == "one.marks.json"


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"marks": [{"text": "a"}]}', '{"marks": [{"onset_ns": "x", "text": "a"}]}', '{"marks": 1}', "{}"],
)
def test_a_file_that_holds_no_marks_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "marks.json").write_text(text)
    with pytest.raises(KinegraphError, match=r"marks\.json"):
        Marks(tmp_path)


def test_there_is_an_end_to_marks(tmp_path: Path) -> None:
    (tmp_path / "marks.json").write_text(
        json.dumps({"marks": [{"onset_ns": n, "text": "x"} for n in range(MAX_MARKS)]})
    )
    marks = Marks(tmp_path)
    with pytest.raises(KinegraphError, match="no more"):
        marks.add([(0, "y")])
    assert len(marks.read()[0]) == MAX_MARKS and np.all(np.diff(marks.read()[0]) >= 0)


def test_panels_with_annotations_show_marks_too() -> None:
    assert shown_with([{"kind": "events", "of": ["a", "annotations"]}]) == [
        {"kind": "events", "of": ["a", "annotations", "marks"]}
    ]
    assert shown_with([{"kind": "signal", "of": ["a"]}])[1]["of"] == ["marks"]
