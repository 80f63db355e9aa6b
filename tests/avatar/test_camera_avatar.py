"""From a camera's frames to an avatar's datagrams: the shipped config `avatar`, its parts, and scenes in which it must invent nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer, body_at, camera_of
from kinegraph.operators.body.background import Background
from kinegraph.operators.body.extrema import Extrema
from kinegraph.operators.body.marker_fusion import Surer
from kinegraph.operators.body.names import MARKERS
from kinegraph.operators.body.persons import Persons
from kinegraph.operators.pose.footing import Footing
from kinegraph.operators.pose.operator import NOTES
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of, local_poses
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.avatar.camera_avatar import rendered_config, run_and_hear
from tests.support.pose_model import pose_network_or_skip

RATE = 30.0
MARKED = StreamSpec((len(MARKERS), 3), rate_hz=RATE, channels=MARKERS, units=("m",))
HANDS = ("Left", "Right")


def hands_over_hips(poses: Samples, times: Samples) -> list[tuple[Samples, Samples]]:
    """For each hand how high it is above the hips (m): in the avatar's poses, and truly."""
    joints = joints_of(usual_body(), poses)[1]
    pairs = []
    for side in HANDS:
        made = joints[:, BONES.index(f"{side}Hand"), 1] - joints[:, 0, 1]
        places = [body_at(t)[0] for t in times.tolist()]
        true = np.array([p[f"{side.lower()}_wrist"][1] - p["left_hip"][1] for p in places])
        pairs.append((made, true))
    return pairs


@pytest.mark.timeout(600)
@pytest.mark.parametrize("network", [False, True], ids=["depth alone", "network"])
@pytest.mark.nightly
def test_the_datagrams_follow_the_performer(network: bool, tmp_path: Path) -> None:
    if network:
        pose_network_or_skip()
    reported, times, poses = run_and_hear(rendered_config(tmp_path, 12.0, network=network), tmp_path)
    asked = [reported.find(word) for word in ("step into view", "stand still", "calibrated; the avatar follows")]
    assert -1 < asked[0] < asked[1] < asked[2], reported
    assert ("there is no pose network" in reported) == (not network)
    assert len(poses) > 300 and np.isfinite(poses).all()
    assert not np.ptp(poses[times < 2.0], axis=0).any(), "nobody is there, and the avatar moves"
    moving = times > 5.0
    follows = [np.corrcoef(made[moving], true[moving])[0, 1] for made, true in hands_over_hips(poses, times)]
    assert min(follows) > (0.7 if network else 0.5), follows
    feet = joints_of(usual_body(), poses[moving])[1][:, [BONES.index(f"{side}Foot") for side in HANDS], 1]
    rest = usual_body().at_rest[BONES.index("LeftFoot"), 1]
    assert abs(np.median(feet.min(axis=1)) - rest) < 0.05, "the avatar does not stand on its floor"


def camera_spec(width: int = 320, height: int = 200) -> StreamSpec:
    camera = dict(zip(("fx", "fy", "cx", "cy"), camera_of(width, height), strict=True))
    return StreamSpec((height, width), np.dtype(np.uint16), rate_hz=RATE, units=("mm",), meta={"camera": camera})


def someone(first: float, last: float) -> tuple[Samples, Samples]:
    """Depth (n, h, w) of the rendered performer alone, 0 elsewhere, as the graph has it; and the truth (n, 13, 3)."""
    performer, background, persons = RenderedPerformer(320, 200), Background(learn_s=0.3), Persons()
    persons.open({"in": background.open({"in": camera_spec()})["out"]})
    at = [*np.zeros(15), *np.arange(first, last, 1 / RATE)]
    made = []
    for k, (stamp, t) in enumerate(zip(grid(RATE, len(at)).tolist(), at, strict=True)):
        frame = Chunk(np.array([stamp]), performer.frame(k, t)[None], stamp)
        before = dict(background.process("in", frame))["out"]
        made.append(dict(persons.process("in", before))["out"].data[0])
    return np.stack(made[15:]), np.stack([performer.joints(t) for t in at[15:]])


def test_depth_alone_finds_head_hands_and_feet() -> None:
    frames, truth = someone(6.0, 8.0)
    extrema = Extrema()
    extrema.open({"in": camera_spec()})
    made = dict(extrema.process("in", Chunk(grid(RATE, len(frames)), frames, 0)))
    markers = made["out"].data[:, [MARKERS.index(name) for name in POINTS]]
    off = 100 * np.linalg.norm(markers - truth, axis=2)
    assert np.isnan(off).mean() < 0.35 and np.nanmedian(off) < 10.0, (np.isnan(off).mean(), np.nanmedian(off))
    assert np.nanmean(off[:, [POINTS.index("head"), POINTS.index("left_ankle"), POINTS.index("right_ankle")]]) < 8.0
    assert ((made["confidence"].data >= 0.5) == np.isfinite(made["out"].data).all(axis=2)).all()


@pytest.mark.parametrize("first", [6.0, 10.0, 20.0])
def test_the_trunks_joints_lie_inside_the_trunk(first: float) -> None:
    """Not on the surface that the camera sees: neither from the front nor where the performer has turned."""
    frames, truth = someone(first, first + 1.0)
    extrema = Extrema()
    extrema.open({"in": camera_spec()})
    made = dict(extrema.process("in", Chunk(grid(RATE, len(frames)), frames, 0)))["out"].data
    for joint in ("shoulder", "hip"):
        found, true = (
            each[:, [names.index(f"{side}_{joint}") for side in ("left", "right")]].mean(axis=1)
            for each, names in ((made, MARKERS), (truth, POINTS))
        )
        assert abs(100 * np.nanmean((found - true)[:, 2])) < 4.5, joint


def test_a_head_that_was_taken_for_a_foot_is_found_again() -> None:
    frames, truth = someone(6.0, 7.0)
    extrema = Extrema()
    extrema.open({"in": camera_spec()})
    times = grid(RATE, len(frames))
    extrema.process("in", Chunk(times[:5], frames[:5], 0))
    state = extrema.state
    state.before[[0, 3]] = state.before[[3, 0]]  # head and left foot, exchanged
    made = dict(extrema.process("in", Chunk(times[5:], frames[5:], 0)))["out"].data
    off = np.linalg.norm(made[-5:, MARKERS.index("head")] - truth[-5:, POINTS.index("head")], axis=1)
    assert off.max() < 0.12


@pytest.mark.parametrize("depth", [0, 65535, 30])
def test_depth_alone_invents_nothing(depth: int) -> None:
    extrema = Extrema()
    extrema.open({"in": camera_spec()})
    frames = np.zeros((5, 200, 320), np.uint16)
    frames[2:4, :2, :3] = depth
    made = dict(extrema.process("in", Chunk(grid(RATE, 5), frames, 0)))
    assert not np.isfinite(made["out"].data).any() and not made["confidence"].data.any()
    with pytest.raises(InputError, match="of unknown geometry"):
        Extrema().open({"in": StreamSpec((20, 20), np.dtype(np.uint16), rate_hz=RATE)})


def standing(n: int) -> Samples:
    """Markers (n, 20, 3) of someone who stands 2 m before the camera."""
    made = np.full((20, 3), np.nan)
    places = {"head": (0.0, -0.6), "shoulder": (0.18, -0.4), "elbow": (0.2, -0.12), "wrist": (0.22, 0.14)}
    places |= {"hip": (0.1, 0.1), "knee": (0.1, 0.52), "ankle": (0.1, 0.94), "toe": (0.1, 0.98)}
    for k, name in enumerate(MARKERS):
        side, _, joint = name.rpartition("_")
        if joint in places:
            x, y = places[joint]
            made[k] = -x if side == "right" else x, y, 2.0
    return np.repeat(made[None], n, 0)


def test_the_surer_way_is_taken_and_what_it_misses_is_filled() -> None:
    times, first, second = grid(RATE, 20), standing(20), standing(20) + 0.01
    wrist, elbow = MARKERS.index("left_wrist"), MARKERS.index("left_elbow")
    first[2:4, wrist] = np.nan
    second[3, wrist] = second[3, elbow] - 2.0  # no forearm is so long
    first[8:14] = np.nan
    surer = Surer()
    surer.open({"first": MARKED, "second": MARKED})
    made = []
    for k, t in enumerate(times.tolist()):
        surer.process("second", Chunk(np.array([t]), second[k : k + 1], t))
        made.append(surer.process("first", Chunk(np.array([t]), first[k : k + 1], t)).data[0])  # type: ignore[union-attr]
    assert np.array_equal(made[2][wrist], second[2, wrist]) and np.isnan(made[3][wrist]).all()
    seen = [np.nanmax(np.abs(row - standing(1)[0])) if np.isfinite(row).any() else np.nan for row in made]
    assert np.allclose(seen[:2], 0.0) and np.allclose(seen[8:16], 0.01) and np.allclose(seen[16:], 0.0)
    with pytest.raises(InputError, match="the same markers"):
        Surer().open({"first": MARKED, "second": StreamSpec((3, 3), rate_hz=RATE)})
    few = StreamSpec((3, 3), rate_hz=RATE, channels=("a", "b", "c"))
    with pytest.raises(ParameterError, match="fill"):
        Surer().open({"first": few, "second": few})


def test_the_other_way_is_left_only_after_as_many_samples_as_it_was_taken_after() -> None:
    """The samples that spoke for it do not count twice."""
    surer, n = Surer(patience=3), 9
    surer.open({"first": MARKED, "second": MARKED})
    times, seen = grid(RATE, n), np.zeros((n, len(MARKERS), 3))
    seen[1:4] = np.nan  # then seen again: for the fourth to the sixth of these it is not believed yet
    made = []
    for k, t in enumerate(times.tolist()):
        surer.process("second", Chunk(np.array([t]), np.ones((1, len(MARKERS), 3)), t))
        made.append(surer.process("first", Chunk(np.array([t]), seen[k : k + 1], t)).data[0, 0, 0])  # type: ignore[union-attr]
    assert made == [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]


def turned(n: int, degrees: float) -> tuple[Samples, Samples]:
    """Poses (n, 91) and joints (n, 22, 3) of someone who stands turned, 1 m under the axes' middle, 3 m away."""
    tree = usual_body()
    half = np.radians(degrees) / 2
    world = np.tile([np.cos(half), 0.0, np.sin(half), 0.0], (n, len(BONES), 1))
    poses = local_poses(tree, np.tile([0.4, tree.offsets[0, 1] - 1.0, -3.0], (n, 1)), world)
    return poses, joints_of(tree, poses)[1]


def footed(poses: Samples, joints: Samples, quality: Samples, **parameters: object) -> tuple[Samples, list[str]]:
    """What Footing makes of them: poses, and what was asked."""
    footing, times = Footing(**parameters), grid(RATE, len(poses))  # type: ignore[arg-type]
    footing.open(
        {
            "pose": usual_body().spec(RATE),
            "joints": StreamSpec((len(BONES), 3), rate_hz=RATE, channels=BONES, units=("m",)),
            "quality": StreamSpec((len(BONES) + len(NOTES),), rate_hz=RATE),
        }
    )
    out, asked = [], list[str]()
    for k, t in enumerate(times.tolist()):
        at = np.array([t])
        footing.process("joints", Chunk(at, joints[k : k + 1], t))
        footing.process("quality", Chunk(at, quality[k : k + 1], t))
        made = dict(footing.process("pose", Chunk(at, poses[k : k + 1], t)))
        out.append(made["out"].data[0])
        asked += made["prompt"].data["state"].tolist()
    return np.array(out), asked


def test_who_was_calibrated_stands_on_the_floor_and_faces_the_front() -> None:
    n, tree = 120, usual_body()
    poses, joints = turned(n, 40.0)
    quality = np.zeros((n, len(BONES) + len(NOTES)))
    quality[:20, : len(BONES)] = quality[100:, : len(BONES)] = 1.0
    quality[50:, len(BONES) + 2] = 1.0
    out, asked = footed(poses, joints, quality)
    assert asked == ["waiting", "stand", "follows", "gone"]
    rest = np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])
    assert np.allclose(out[:50], rest)
    assert np.allclose(out[-1, :3], [0.0, tree.offsets[0, 1], 0.0], atol=1e-6)
    assert np.allclose(out[-1, 3:7], [1.0, 0.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("size", "scale"), [(0.5, 0.5), (0.05, 1.0)], ids=["a child", "no legs to speak of"])
def test_a_step_is_as_long_as_the_avatar_s_legs_make_it(size: float, scale: float) -> None:
    n, tree = 60, usual_body()
    poses, joints = turned(n, 0.0)
    joints *= size
    poses[:, :3] = joints[:, 0]
    poses[30:, 0] += 0.3
    joints[30:, :, 0] += 0.3
    quality = np.zeros((n, len(BONES) + len(NOTES)))
    quality[:, len(BONES) + 2] = 1.0
    out, _ = footed(poses, joints, quality)
    assert np.allclose(out[-1, 0] - out[20, 0], 0.3 / scale, atol=1e-6)
    if scale == size:
        assert np.allclose(out[20, 1], tree.offsets[0, 1], atol=1e-6)


def test_without_a_calibration_the_avatar_follows_after_a_while() -> None:
    poses, joints = turned(120, 0.0)
    out, asked = footed(poses, joints, np.zeros((120, len(BONES) + len(NOTES))), uncalibrated_s=2.0)
    assert asked == ["stand", "lost"] and np.allclose(out[-1, :3], [0.0, usual_body().offsets[0, 1], 0.0], atol=1e-6)


def test_where_only_the_upper_body_is_seen_the_legs_rest_and_the_prompt_asks_to_step_back() -> None:
    """As at 1.3 m from a camera, where knees and feet are out of its view."""
    n, tree = 150, usual_body()
    poses, joints = turned(n, 0.0)
    poses[:, 3 + 4 * BONES.index("LeftUpperLeg") :][:, :4] = np.cos(0.5), -np.sin(0.5), 0.0, 0.0  # a guess
    quality = np.zeros((n, len(BONES) + len(NOTES)))
    quality[:, len(BONES) + 2] = 1.0
    quality[30:120, [b for b, bone in enumerate(BONES) if bone.endswith(("Leg", "Foot", "Toes"))]] = 1.0
    out, asked = footed(poses, joints, quality)
    assert asked == ["follows", "upper", "follows"]
    places = joints_of(tree, out)[1]
    knee = places[:, BONES.index("LeftLowerLeg"), 2] - places[:, BONES.index("LeftUpperLeg"), 2]
    assert knee[50] > 0.3 and abs(knee[100]) < 0.02 and knee[-1] > 0.3
    assert places[100, BONES.index("LeftFoot"), 1] == pytest.approx(tree.at_rest[BONES.index("LeftFoot"), 1], abs=0.01)


def test_a_trunk_that_lies_is_reported() -> None:
    poses, joints = turned(150, 0.0)
    quality = np.zeros((150, len(BONES) + len(NOTES)))
    quality[:, len(BONES) + 2] = 1.0
    joints[30:100] = joints[30:100][..., [1, 0, 2]]  # on the side
    joints[110:120] = joints[110:120][..., [1, 0, 2]]  # bent down for a moment
    assert footed(poses, joints, quality)[1] == ["follows", "lying", "follows"]


def test_who_sits_has_bent_legs_and_no_bone_turns_too_fast() -> None:
    poses, joints = turned(60, 0.0)
    quality = np.zeros((60, len(BONES) + len(NOTES)))
    quality[:, len(BONES) + 2] = 1.0
    poses[30:, 3 + 4 * BONES.index("LeftUpperArm") :][:, :4] = 0.0, 1.0, 0.0, 0.0  # half a turn at once
    out, _ = footed(poses, joints, quality, seated=True)
    turns, places = joints_of(usual_body(), out)
    knee, hip, foot = (places[-1, BONES.index(f"Left{b}")] for b in ("LowerLeg", "UpperLeg", "Foot"))
    assert knee[2] - hip[2] == pytest.approx(0.43, abs=0.02) and foot[1] < knee[1] - 0.4
    cosines = np.abs((turns[1:] * turns[:-1]).sum(axis=-1)).clip(0, 1)
    assert 2 * np.arccos(cosines).max() <= 20.0 / RATE + 1e-6
