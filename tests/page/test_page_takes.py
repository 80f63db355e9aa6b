"""Takes that are recorded on the page: between two presses of a button, as a VRM animation and as BVH."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.devices.page.hub import Hub
from kinegraph.devices.page.takes import Takes
from kinegraph.devices.page.transfer.wire import RecordTake, asked
from kinegraph.devices.people.performer import true_pose
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.domain.fingers import BENDS
from kinegraph.stream.domain.humanoid import usual_body
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import grid
from tests.files.test_motion_out import gltf_of, is_vrm_animation, numbers
from tests.support.browser import needs_browser
from tests.support.live_browser import live_browser
from tests.support.page_session import needs_page, page_process

TREE = usual_body()
POSES = np.array([true_pose(2.0 + k / 30) for k in range(60)])
PANELS = [{"kind": "signal", "of": ["body.quality"]}, {"kind": "avatar", "of": ["body.pose"]}]


@pytest.fixture
def live() -> tuple[Takes, Any]:
    """Takes of a session, and what its stream of poses brings chunks to."""
    takes, edge = Takes(PANELS, {"body.pose": TREE.spec(30.0)}), SimpleNamespace(observers=[])
    takes.observe(SimpleNamespace(edges={"body.pose": edge}))  # type: ignore[arg-type]
    (observe,) = edge.observers
    return takes, lambda a, b: observe(Chunk(grid(30.0, 60)[a:b], POSES[a:b], 0))


def test_a_take_holds_what_came_between_two_presses(live: tuple[Takes, Any], tmp_path: Path) -> None:
    takes, comes = live
    comes(0, 10)
    assert takes.begin(" my <dance> ") == "my_dance"
    comes(10, 30)
    comes(30, 50)
    files = takes.end(tmp_path / "takes")
    comes(50, 60)
    assert [file.name for file in files] == ["my_dance.vrma", "my_dance.glb", "my_dance.bvh"]
    document, data = gltf_of(files[0])
    is_vrm_animation(document, data, POSES[10:50])  # type: ignore[arg-type]
    (animation,) = document["animations"]  # type: ignore[misc]
    assert numbers(document, data, animation["samplers"][0]["input"])[[0, -1]] == pytest.approx([0.0, 39 / 30])
    assert len(read_bvh(files[2], "cm")[0].data) == 40


def test_a_take_holds_the_hands_and_the_face_of_its_panel(tmp_path: Path) -> None:
    streams = {
        "body.pose": (TREE.spec(30.0), POSES),
        "fingers": (StreamSpec((40,), rate_hz=30.0, channels=BENDS, units=("deg",)), np.full((60, 40), 50.0)),
        "face": (StreamSpec((2,), rate_hz=30.0, channels=("Blink_L", "Blink_R")), np.full((60, 2), 0.25)),
    }
    takes = Takes([{"kind": "avatar", "of": list(streams)}], {name: spec for name, (spec, _) in streams.items()})
    edges = {name: SimpleNamespace(observers=[]) for name in streams}
    takes.observe(SimpleNamespace(edges=edges))  # type: ignore[arg-type]
    takes.begin("wave")
    for name, (_, rows) in streams.items():
        for observe in edges[name].observers:
            observe(Chunk(grid(30.0, 60), rows, 0))
    document, _ = gltf_of(takes.end(tmp_path)[0])
    facts = document["extensions"]["VRMC_vrm_animation"]  # type: ignore[index]
    assert len(facts["humanoid"]["humanBones"]) == 52 and list(facts["expressions"]["preset"]) == [
        "blinkLeft",
        "blinkRight",
    ]
    assert "LeftIndexDistal" in (tmp_path / "wave.bvh").read_text()


def test_a_take_is_bounded_where_only_hands_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.page.takes.MAX_SAMPLES", 100)
    spec = StreamSpec((40,), rate_hz=30.0, channels=BENDS, units=("deg",))
    takes = Takes([{"kind": "avatar", "of": ["pose", "fingers"]}], {"pose": TREE.spec(30.0), "fingers": spec})
    edges = {name: SimpleNamespace(observers=[]) for name in ("pose", "fingers")}
    takes.observe(SimpleNamespace(edges=edges))  # type: ignore[arg-type]
    takes.begin("still")
    for _ in range(10):
        edges["fingers"].observers[0](Chunk(grid(30.0, 60), np.zeros((60, 40)), 0))
    assert sum(len(chunk.time) for chunk in takes._kept["fingers"]) <= 160


def test_no_take_is_overwritten_and_an_empty_one_is_refused(live: tuple[Takes, Any], tmp_path: Path) -> None:
    takes, comes = live
    names = []
    for called in ("", "take", "../../etc"):
        takes.begin(called)
        comes(0, 5)
        names += [file.relative_to(tmp_path).as_posix() for file in takes.end(tmp_path) if file.suffix == ".bvh"]
    assert names == ["take.bvh", "take-2.bvh", "etc.bvh"]
    takes.begin("silent")
    with pytest.raises(KinegraphError, match="no pose has come"):
        takes.end(tmp_path)
    with pytest.raises(KinegraphError, match="no take runs"):
        takes.end(tmp_path)


def test_a_page_without_an_avatar_and_a_replay_record_no_takes() -> None:
    assert Takes(PANELS[:1], {"body.quality": TREE.spec(30.0)}).name == ""
    hub = Hub(lambda wanted: pytest.fail("nothing reaches the session"))
    wish = asked('{"do": "take", "name": "a", "on": true}')
    assert wish == RecordTake("a", True)
    for hello in ({"mode": "live", "takes": False}, {"mode": "replay", "takes": True}):
        hub.hello = hello
        with pytest.raises(ValueError, match=r"avatar|replay"):
            hub.take(hub.visitor(), wish)


GRAPH = """
name: dance
nodes:
  performer: {use: devices.people.performer.Performer}
page: {panels: [{kind: avatar, of: performer.pose, wide: 4}]}
"""


@needs_page
@needs_browser
@pytest.mark.nightly
@pytest.mark.timeout(280)
def test_the_button_writes_a_take_beside_the_recording(tmp_path: Path) -> None:
    (tmp_path / "dance.yaml").write_text(GRAPH)
    with (
        live_browser(tmp_path) as browser,
        page_process(tmp_path, "run", "dance.yaml", "--view", "none", "-o", "s") as run,
    ):
        browser.open(run.url, 900, 900)
        browser.wait("document.querySelector('.avatar')?.dataset.bones")
        button = "[...document.querySelectorAll('#controls button')].find((b) => b.textContent.includes('take'))"
        said = "document.querySelector('#status').textContent"
        browser.value("document.querySelector('[aria-label=\"name of the take\"]').value = 'jump'")
        written = ""
        for _ in range(60):  # until the session has begun, and poses come
            browser.value(f"{button}.click()")
            begun = browser.value("performance.now()")
            browser.wait(f"performance.now() > {begun} + 1000")
            browser.value(f"{button}.click()")
            written = browser.wait(f"{said}.startsWith('take ') && {said}")
            if "not written" not in written:
                break
        assert "jump.vrma" in written
        assert run.stop() in (0, 130)
        assert browser.complaints == []
    assert sorted(path.name for path in (tmp_path / "s" / "takes").iterdir()) == ["jump.bvh", "jump.glb", "jump.vrma"]
    document, _ = gltf_of(tmp_path / "s" / "takes" / "jump.vrma")
    assert document["animations"]
