"""The page's avatar with fingers and a face: what the streams beside its pose say, it shows."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.performer import true_pose
from kinegraph.operators.body.camera.expressions import EXPRESSIONS
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.domain.fingers import BENDS
from kinegraph.stream.domain.humanoid import usual_body
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.live_browser import live_browser
from tests.support.page_session import needs_page, page_process
from tests.support.pose_model import camera_networks_or_skip

pytestmark = [needs_page, needs_browser, pytest.mark.timeout(280)]
GRAPH = """
page:
  panels:
    - {kind: avatar, of: [lab.pose, lab.fingers, lab.face], title: avatar, tall: 2, wide: 2}
nodes:
  lab: {use: devices.recorded.recorded_streams.RecordedStreams, path: given.mcap, speed: 0}
"""


def test_fingers_bend_and_eyes_blink_as_their_streams_say(tmp_path: Path) -> None:
    n, later = 120, slice(60, None)
    times = np.arange(1, n + 1) * (NS // 30)
    fingers, face = np.zeros((n, len(BENDS))), np.zeros((n, len(EXPRESSIONS)))
    fingers[later, [name.endswith(("bend", "bend2", "bend3")) for name in BENDS]] = 70.0
    face[later, EXPRESSIONS.index("Blink_L")], face[later, EXPRESSIONS.index("A")] = 1.0, 0.8
    given = [
        Series("lab.pose", usual_body().spec(30.0), times, np.repeat(true_pose(0.0)[None], n, 0)),
        Series("lab.fingers", StreamSpec((len(BENDS),), rate_hz=30.0, channels=BENDS, units=("deg",)), times, fingers),
        Series("lab.face", StreamSpec((len(EXPRESSIONS),), rate_hz=30.0, channels=EXPRESSIONS), times, face),
    ]
    write_recording(tmp_path / "given.mcap", given, {})
    (tmp_path / "live.yaml").write_text(GRAPH)
    command = [str(KINEGRAPH), "run", "live.yaml", "--view", "none", "-o", "s"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    shown = "document.querySelector('.avatar')?.dataset.live"
    with live_browser(tmp_path) as browser, page_process(tmp_path, "view", tmp_path / "s") as process:
        browser.open(process.url, 1000, 1000)
        browser.wait(f"{shown} && document.body.dataset.state === 'recording'")
        browser.press("Home")
        browser.wait(f"+{shown}.split(' ')[3] === 0")
        flat = [float(v) for v in browser.value(shown).split()]
        browser.press("End")
        browser.wait(f"+{shown}.split(' ')[3] > .9")
        bent = [float(v) for v in browser.value(shown).split()]
        browser.picture(tmp_path / "live.png", ".avatar")
        assert browser.complaints == []
    assert flat[3:] == [0.0, 0.0] and bent[3:] == pytest.approx([1.0, 0.8], abs=0.01)
    assert np.linalg.norm(np.array(bent[:3]) - flat[:3]) > 0.03


WATCH = """
window.most = [0, 0, 0]; window.first = null;
setInterval(() => {
  const shown = document.querySelector('.avatar')?.dataset.live?.split(' ').map(Number);
  if (!shown) return;
  first ??= shown;
  const way = Math.hypot(...[0, 1, 2].map((k) => shown[k] - first[k]));
  most = [Math.max(most[0], way), Math.max(most[1], shown[3]), Math.max(most[2], shown[4])];
}, 20), 1
"""
"""How far a finger's end has been from where it began (m), and the most of blink and mouth."""


@pytest.mark.nightly
def test_hands_eyelids_and_mouth_of_the_avatar_follow_the_shipped_clip(tmp_path: Path) -> None:
    camera_networks_or_skip()
    words = ("run", "webcam_avatar", "--simulate", "--view", "none", "--no-record")
    with live_browser(tmp_path) as browser, page_process(tmp_path, *words) as process:
        browser.open(process.url, 1000, 1000)
        browser.wait("document.querySelector('.avatar')?.dataset.live")
        browser.value(WATCH)
        browser.wait("most[0] > .1 && most[1] > .5 && most[2] > .3")
        assert browser.complaints == []
