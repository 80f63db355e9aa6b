"""An avatar on the page: its bones stand where the pose says, in a real browser; the one file that is shown, and no other."""

from __future__ import annotations

import json
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.devices.formats.gltf.vrm_reader import read_vrm
from kinegraph.devices.page.avatar_file import AVATAR, checked_avatar
from kinegraph.devices.page.transfer.poses import avatar_bones
from kinegraph.stream.chunk import NS, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, to_humanoid, usual_body
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests import mannequin
from tests.support.browser import needs_browser
from tests.support.command_line import KINEGRAPH
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import needs_page, page_process

pytestmark = [needs_page, pytest.mark.timeout(280)]

SECONDS = 8
GRAPH = f"""
name: avatar
page:
  panels:
    - {{kind: avatar, of: performer.pose, title: avatar, tall: 2, wide: 2}}
    - {{kind: scene, of: performer.markers, title: markers, tall: 2, wide: 2}}
nodes:
  performer: {{use: devices.people.performer.Performer, realtime: false, duration_s: {SECONDS}}}
"""
LEGS = ("LeftLowerLeg", "LeftFoot")


def older(path: Path) -> Path:
    """The avatar that comes with the page as a file of VRM 0.x, facing the other way, without a chest, and 2 % taller."""
    data = AVATAR.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document: dict[str, Any] = json.loads(data[20 : 20 + length])
    bones = document.pop("extensions")["VRMC_vrm"]["humanoid"]["humanBones"]
    document["extensionsUsed"] = ["VRM"]
    kept = [{"bone": bone, "node": entry["node"]} for bone, entry in bones.items() if bone != "upperChest"]
    document["extensions"] = {
        "VRM": {"specVersion": "0.0", "meta": {"title": "test"}, "humanoid": {"humanBones": kept}, "firstPerson": {},
                "blendShapeMaster": {"blendShapeGroups": []}, "secondaryAnimation": {"boneGroups": [], "colliderGroups": []},
                "materialProperties": []}
    }  # fmt: skip
    roots = document["scenes"][0]["nodes"]
    document["nodes"].append({"name": "facing", "children": roots, "rotation": [0, 1, 0, 0], "scale": [1.02] * 3})
    document["scenes"][0]["nodes"] = [len(document["nodes"]) - 1]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + rest
    )
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded performer with an avatar that follows the true poses."""
    folder = tmp_path_factory.mktemp("avatar")
    (folder / "avatar.yaml").write_text(GRAPH)
    command = [str(KINEGRAPH), "run", "avatar.yaml", "--view", "none", "-o", "s"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "s"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveBrowser]:
    with live_browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


def expected(recording: Path, avatar: Path, at_s: float) -> Samples:
    """Where the avatar's left hand, right hand and head must be (m): the pose's rotations on the avatar's own bones."""
    with Recording.open(recording) as opened:
        begin = min(s.first for s in opened.streams.values() if s.first is not None)
        time, poses = opened.read("performer.pose")
    pose = np.array(poses[np.searchsorted(time, begin + round(at_s * NS), side="right") - 1], float)
    body, tree = JointTree.of(_spec(recording)), read_vrm(avatar)
    pose[:3] *= leg(tree) / leg(body)
    bones = [BONES.index(bone) for bone in ("LeftHand", "RightHand", "Head")]
    return np.asarray(joints_of(tree, pose[None])[1][0, bones])


def _spec(recording: Path) -> Any:
    with Recording.open(recording) as opened:
        return opened.streams["performer.pose"].spec


def leg(tree: JointTree) -> float:
    return sum(float(np.linalg.norm(tree.offsets[BONES.index(bone)])) for bone in LEGS)


@needs_browser
@pytest.mark.parametrize("own", [False, True], ids=["the page's avatar, VRM 1.0", "a performer's own, VRM 0.x"])
def test_an_avatar_stands_as_the_pose_says(own: bool, recorded: Path, browser: LiveBrowser, tmp_path: Path) -> None:
    avatar = older(tmp_path / "me.vrm") if own else AVATAR
    with page_process(tmp_path, "view", recorded, *(["--avatar", avatar] if own else [])) as process:
        browser.open(process.url, 1400, 1400)
        browser.value("document.documentElement.dataset.theme = 'light'")
        browser.wait("document.querySelector('.avatar')?.dataset.bones && document.body.dataset.state === 'recording'")
        empty = browser.colours(".avatar canvas")
        browser.press("Home")
        browser.wait("+document.body.dataset.looked === 0")
        places = []
        for second in (1, 2, 3):
            browser.press("ArrowRight", second - round(browser.value("+document.body.dataset.looked")))
            browser.wait(f"Math.abs(document.body.dataset.looked - {second}) < .001")
            with Recording.open(recorded) as opened:
                begin = min(s.first for s in opened.streams.values() if s.first is not None)
                time = (opened.read("performer.pose")[0] - begin) / NS
            newest = float(time[time <= second + 1e-9][-1])
            browser.wait(f"Math.abs(document.querySelector('.avatar').dataset.at - {newest}) < .001")
            reported = browser.value("document.querySelector('.avatar').dataset.bones")
            places.append(np.array([[float(v) for v in at.split()] for at in reported.split(", ")]))
            assert np.abs(places[-1] - expected(recorded, avatar, second)).max() < 0.002, second
        assert np.ptp(places, axis=0).max() > 0.1, "it does not move"
        assert browser.colours(".avatar canvas") > 50 and empty > 1, "a shaded body has many colours"
        if not own:
            browser.picture(tmp_path / "page-avatar.png", ".avatar")
        assert browser.complaints == []
        with urlopen(process.at("avatar.vrm"), timeout=100) as reported:
            assert reported.read() == avatar.read_bytes()
        for path in ("other.vrm", "avatar.vrm/../me.vrm", "me.vrm"):
            with pytest.raises(HTTPError, match="404"):
                urlopen(process.at(path), timeout=100)


@needs_browser
def test_the_avatar_stands_alone_on_a_transparent_page(recorded: Path, browser: LiveBrowser, tmp_path: Path) -> None:
    """The address ends with #avatar: for OBS, which lays the page over a picture."""
    with page_process(tmp_path, "view", recorded) as process:
        browser.open(f"{process.url}#avatar", 800, 600)
        browser.wait("document.querySelector('.avatar')?.dataset.bones")
        shown = "[...document.querySelectorAll('header, footer, .panel')].filter((e) => e.offsetParent).map((e) => e.className)"
        assert browser.value(f"{shown}.filter((name) => !name.includes('avatar')).length") == 0
        assert browser.value("getComputedStyle(document.body).backgroundColor") == "rgba(0, 0, 0, 0)"
        assert browser.value("+document.querySelector('.avatar canvas').clientHeight > 550")
        assert browser.complaints == []


def test_the_mannequin_is_what_its_code_makes(tmp_path: Path) -> None:
    mannequin.write(tmp_path / "made.vrm")
    shipped, made = AVATAR.read_bytes(), (tmp_path / "made.vrm").read_bytes()
    assert len(made) == len(shipped)
    (length,) = struct.unpack_from("<I", made, 12)
    one, other = (json.loads(data[20 : 20 + length].rstrip()) for data in (shipped, made))
    for document in (one, other):
        for accessor in document["accessors"]:
            accessor.pop("min", 0), accessor.pop("max", 0)
    assert one == other
    where = one["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    view = one["bufferViews"][one["accessors"][where]["bufferView"]]
    places = [
        np.frombuffer(d, "<f4", view["byteLength"] // 4, 28 + length + view["byteOffset"]) for d in (shipped, made)
    ]
    assert np.abs(places[0] - places[1]).max() < 1e-4
    assert read_vrm(AVATAR).at_rest == pytest.approx(usual_body().at_rest, abs=1e-6)
    assert 1.7 < np.ptp(places[0].reshape(-1, 3)[:, 1]) < 1.85 and abs(places[0].reshape(-1, 3)[:, 1].min()) < 0.01


def test_what_is_no_avatar_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no.vrm").write_bytes(b"glTF")
    with pytest.raises(KinegraphError, match="no such file"):
        checked_avatar(tmp_path / "missing.vrm")
    with pytest.raises(KinegraphError, match="is not a VRM avatar"):
        checked_avatar(tmp_path / "no.vrm")
    assert checked_avatar(None) == AVATAR


def test_bones_of_another_skeleton_are_turned_as_its_joints_are() -> None:
    """What the page makes of the facts is what `to_humanoid` makes of the pose."""
    rng = np.random.default_rng(4)
    joints = (
        "Hips",
        "Spine",
        "Neck",
        "Head",
        *(f"{s}{b}" for s in ("Left", "Right") for b in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")),
    )
    parents = [-1, 0, 1, 2, 2, 4, 5, 0, 7, 8, 2, 10, 11, 0, 13, 14]
    tree = JointTree(joints, np.array(parents), rng.normal(size=(len(joints), 3)))
    turns = Rotation.random(len(joints), rng=5)
    pose = np.r_[0.0, 1.0, 0.0, turns.as_quat(scalar_first=True).ravel()]
    facts = avatar_bones(tree.spec(30.0))
    assert facts and [bone["bone"] for bone in facts["bones"]][:2] == ["hips", "spine"]
    world: list[Rotation] = []
    for joint, parent in enumerate(facts["parents"]):
        world.append(turns[joint] if parent < 0 else world[parent] * turns[joint])
    bones: list[Rotation] = []
    for bone in facts["bones"]:
        own = Rotation.from_quat(bone["turn"], scalar_first=True)
        bones.append(world[bone["joint"]] * own if bone["joint"] >= 0 else bones[bone["parent"]] * own)
    made, rows = to_humanoid(tree, pose[None])
    whole = joints_of(made, rows)[0][0]
    same = [abs(float(np.dot(q, r.as_quat(scalar_first=True)))) for q, r in zip(whole, bones, strict=True)]
    assert min(same) > 1 - 1e-9
    assert avatar_bones(JointTree(("base", "tip"), np.array([-1, 0]), np.zeros((2, 3))).spec(30.0)) is None


@needs_browser
@pytest.mark.parametrize("axes", ["camera", ""])
def test_markers_of_a_camera_stand_on_their_feet(axes: str, browser: LiveBrowser, tmp_path: Path) -> None:
    """A camera's y points down, a laboratory's up."""
    names, high = ("head", "hip", "toe"), np.array([1.7, 0.9, 0.0])
    places = np.stack([[0.0, 0.1, 0.2], -high if axes else high, [2.0, 2.0, 1.9]], axis=1)
    spec = StreamSpec((3, 3), rate_hz=30.0, channels=names, units=("m",), meta={"axes": axes} if axes else {})
    series = Series("markers", spec, grid(30.0, 60), np.repeat(places[None], 60, axis=0))
    write_recording(tmp_path / "m.mcap", [series], {"graph": "", "session": {}})
    with page_process(tmp_path, "view", tmp_path / "m.mcap") as process:
        browser.open(process.url, 900, 900)
        browser.wait("document.querySelectorAll('.scene .name:not([hidden])').length === 3")
        script = "[...document.querySelectorAll('.scene .name')].map(e => +e.style.transform.match(/-?[\\d.]+/g)[1])"
        head, hip, toe = browser.value(script)
        assert head < hip < toe, "upside down"
        assert browser.complaints == []
