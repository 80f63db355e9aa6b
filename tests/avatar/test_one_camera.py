"""A person before one ordinary camera: how far away, where the joints are, and who is followed."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer, camera_of
from kinegraph.operators.body.camera import image_pose
from kinegraph.operators.body.camera.detector import SeenPerson, middle_one
from kinegraph.operators.body.camera.distance import BODY, bones_of, distance, scale_of
from kinegraph.operators.body.camera.image_pose import ImagePose
from kinegraph.operators.body.camera.one_camera import OneCamera
from kinegraph.operators.body.names import LANDMARKS, MARKERS, SEEN
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import grid
from tests.support.pose_model import camera_networks_or_skip

CAMERA = np.array([450.0, 450.0, 319.5, 239.5])
BODY_AT = {
    "nose": (0.0, -0.62, -0.1), "shoulder": (0.18, -0.47, 0.0), "elbow": (0.25, -0.20, 0.05), "wrist": (0.25, 0.0, -0.1),
    "hip": (0.099, 0.0, 0.0), "knee": (0.1, 0.41, -0.03), "ankle": (0.1, 0.83, 0.0), "heel": (0.1, 0.88, 0.05), "toe": (0.12, 0.9, -0.15),
}  # fmt: skip


def seen(away_m: float, size: float = 1.0, aside_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """What a perfect network would see of a standing body `size` times as large, and where its landmarks are."""
    body = np.zeros((34, 3))
    for k, name in enumerate(LANDMARKS):
        part = name.partition("_")[2] or name
        x, y, z = BODY_AT.get(part, BODY_AT["nose"])
        body[k] = (x if name.startswith("left") else -x, y, z)
    places = size * body + (aside_m, 0.1, away_m)
    points = np.full((34, 8), np.nan)
    points[:, 0] = CAMERA[0] * places[:, 0] / places[:, 2] + CAMERA[2]
    points[:, 1] = CAMERA[1] * places[:, 1] / places[:, 2] + CAMERA[3]
    points[:, 3:5], points[:, 5:8] = 0.98, body
    return points, places


@pytest.mark.parametrize("away_m", [1.5, 3.0, 6.0])
@pytest.mark.parametrize("size", [0.7, 1.0, 1.15])
def test_the_distance_follows_from_the_bodys_size(away_m: float, size: float) -> None:
    points, places = seen(away_m, size, aside_m=0.4)
    lengths = bones_of(1.75 * size)
    scale = scale_of(points, lengths)
    assert scale == pytest.approx(size, rel=0.1)
    assert distance(points, CAMERA, size, BODY) == pytest.approx(places[23:25, 2].mean(), rel=1e-3)


def test_a_body_that_is_hardly_seen_has_no_distance() -> None:
    points, _ = seen(3.0)
    points[12:, 3] = 0.1
    assert np.isnan(distance(points, CAMERA, 1.0, BODY))
    far, _ = seen(900.0)
    assert np.isnan(distance(far, CAMERA, 1.0, BODY))


def markers_of(points: list[np.ndarray], height_m: float = 1.75) -> np.ndarray:
    meta = {"camera": dict(zip(("fx", "fy", "cx", "cy"), CAMERA.tolist(), strict=True))}
    operator, rows = OneCamera(height_m=height_m), np.zeros(len(points), SEEN)
    operator.open({"in": StreamSpec((), SEEN, rate_hz=30.0, units=("px, m", "", ""), meta=meta)})
    rows["points"], rows["presence"] = points, 0.95
    times = grid(30.0, len(points))
    return operator.process("in", Chunk(times, rows, int(times[-1])))[0][1].data


def test_joints_are_where_they_are_and_as_far_as_the_person_is_tall() -> None:
    points, places = seen(3.0)
    made = markers_of([points] * 10)[-1]
    truth = np.array([places[LANDMARKS.index(name)] for name in MARKERS])
    limbs = [
        MARKERS.index(f"{side}_{joint}")
        for side in ("left", "right")
        for joint in ("shoulder", "wrist", "hip", "ankle")
    ]
    assert np.linalg.norm(made - truth, axis=1)[limbs].max() < 0.12
    smaller = markers_of([points] * 10, height_m=1.4)[-1]
    np.testing.assert_allclose(smaller[limbs, 2], made[limbs, 2] * 0.8, rtol=0.05)


def test_of_several_people_the_large_one_near_the_middle_is_taken() -> None:
    def at(x: float, side: float) -> SeenPerson:
        return SeenPerson(0.9, np.array([x, 240.0, side, 0.0]))

    assert middle_one([at(100, 300), at(330, 280)], 640, 480).square[0] == 330
    assert middle_one([at(320, 60), at(420, 400)], 640, 480).square[0] == 420
    assert middle_one([], 640, 480) is None


def test_images_without_a_lens_are_refused() -> None:
    with pytest.raises(InputError, match="camera"):
        ImagePose(model="figure").open({"in": StreamSpec((48, 64, 3), np.dtype(np.uint8), rate_hz=30.0)})


def test_a_rendered_person_is_found_and_placed_by_the_networks() -> None:
    """The performer of capsules, whose joints are known; the network was made for people."""
    camera_networks_or_skip()
    performer, meta = (
        RenderedPerformer(320, 240),
        {"camera": dict(zip(("fx", "fy", "cx", "cy"), camera_of(320, 240), strict=True))},
    )
    images = np.array([np.repeat(performer.image(k, k / 30)[..., None], 3, 2) for k in range(150, 165)])
    network, placed = ImagePose(), OneCamera(height_m=1.72)
    placed.open(
        {"in": network.open({"in": StreamSpec((240, 320, 3), np.dtype(np.uint8), rate_hz=30.0, meta=meta)})["out"]}
    )
    times = grid(30.0, len(images))
    events = network.process("in", Chunk(times, images, int(times[-1])))
    assert (events.data["presence"] > 0.5).all()
    made = placed.process("in", events)[0][1].data
    names = [name for name in POINTS if name != "head"]
    truth = np.array([performer.joints(k / 30) for k in range(150, 165)])[:, [POINTS.index(name) for name in names]]
    off = np.linalg.norm(made[:, [MARKERS.index(name) for name in names]] - truth, axis=2)
    assert np.nanmedian(off) < 0.25 and np.isfinite(off).mean() > 0.8


def dressed(at: dict[int, tuple[int, int, int]]) -> np.ndarray:
    """An image in which people stand at these x, in clothes of these colours."""
    image = np.full((240, 320, 3), 120, np.uint8)
    for x, colour in at.items():
        image[80:180, x - 15 : x + 15] = colour
    return image


def following() -> ImagePose:
    """The operator before images of 320 x 240."""
    camera = dict.fromkeys(("fx", "fy", "cx", "cy"), 200.0)
    operator = ImagePose(model=image_pose.FIGURE)
    operator.open({"in": StreamSpec((240, 320, 3), np.dtype(np.uint8), rate_hz=30.0, meta={"camera": camera})})
    return operator


def test_a_person_behind_whom_another_one_crossed_is_found_again_by_the_clothes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mine, other = np.array([100.0, 130.0, 230.0, 0.0]), np.array([240.0, 130.0, 230.0, 0.0])
    image = dressed({100: (40, 60, 220), 240: (210, 50, 40)})
    in_sight = [other, mine]
    monkeypatch.setattr(
        image_pose, "people_in", lambda image, path: [SeenPerson(0.9, square.copy()) for square in in_sight]
    )
    operator = following()
    state = operator.state
    times = grid(30.0, 400).tolist()
    for time in times[:30]:
        state.square[:] = mine
        operator._recognise(image, time)
    state.square[:] = other  # it crossed before the person, and the network went with it
    operator._recognise(image, times[30])
    assert state.square.tolist() == mine.tolist()
    in_sight.pop()
    state.square[:] = other
    for time in times[31:]:
        operator._recognise(image, time)
        assert state.square.tolist() == other.tolist(), "the person is gone: whoever is there is followed"
    in_sight.append(mine)
    operator._recognise(image, times[-1] + NS)
    assert state.square.tolist() == other.tolist(), "and is the person after a while"


def test_whoever_is_found_after_a_loss_is_not_doubted_since_before_it() -> None:
    """Else a stranger would be taken for the person at the first look."""
    operator = following()
    operator.state.square[:], operator.state.doubted = np.nan, 5
    assert operator._find(np.zeros((240, 320, 3), np.uint8)) and operator.state.doubted == 0


def test_a_person_who_turns_or_walks_into_the_shade_is_not_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = np.array([100.0, 130.0, 230.0, 0.0])
    monkeypatch.setattr(
        image_pose,
        "people_in",
        lambda image, path: [SeenPerson(0.9, np.array([240.0, 130.0, 230.0, 0.0])), SeenPerson(0.9, mine + 2)],
    )
    operator = following()
    for k, time in enumerate(grid(30.0, 90).tolist()):
        operator.state.square[:] = mine
        shade = 1.0 if k < 30 else 0.4
        operator._recognise(dressed({100: tuple(int(shade * c) for c in (40, 60, 220)), 240: (210, 50, 40)}), time)
        assert np.abs(operator.state.square - mine).max() <= 2
