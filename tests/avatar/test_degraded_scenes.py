"""What a depth camera may see instead of one person in full view: nothing is invented, no bone turns too fast, no NaN comes out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from devices.simulators.rendered_performer import RenderedPerformer, camera_of
from operators.body.background import Background
from operators.body.extrema import Extrema
from operators.body.persons import Persons
from operators.whole_pose.footing import Footing
from operators.whole_pose.operator import WholePose
from stream.chunk import Array, Chunk, Samples, StreamSpec
from stream.humanoid import BONES, NUMBERS, usual_body
from stream.joint_tree import joints_of
from stream.operator import grid

WIDTH, HEIGHT = 160, 100
Scene = Callable[[int, Array], Array]
FROM_S, UNTIL_S, END_S = 4.5, 6.0, 7.5
"""The trouble lasts from 4.5 s to 6 s; the performer is in view from 2 s on."""


def gone(k: int, frame: Array) -> Array:
    return RenderedPerformer(WIDTH, HEIGHT).frame(k, 0.0)


def moved(k: int, frame: Array) -> Array:
    """All is farther away than the room was: the camera points elsewhere."""
    return np.full_like(frame, 60000)


def invalid(k: int, frame: Array) -> Array:
    return np.zeros_like(frame)


def half(k: int, frame: Array) -> Array:
    """A table hides the legs."""
    made = frame.copy()
    made[HEIGHT // 2 :] = 1200
    return made


def side(k: int, frame: Array) -> Array:
    """The person stands half out of the picture."""
    return np.roll(frame, WIDTH // 2 - 8, axis=1)


def crossing(k: int, frame: Array) -> Array:
    """Somebody else passes between the person and the camera."""
    made, left = frame.copy(), int(4 * (k % 45)) - 20
    made[10:95, max(0, left) : max(0, left + 22)] = 1500
    return made


def upside_down(k: int, frame: Array) -> Array:
    return frame[::-1]


def noise(k: int, frame: Array) -> Array:
    return np.random.default_rng(k).integers(0, 5000, frame.shape).astype(np.uint16)


def through(scene: Scene, rate_hz: float) -> tuple[Samples, Samples, Samples]:
    """The avatar's poses (n, 91), the person's joints (n, 22, 3) and how many bones are guessed (n,), frame by frame."""
    camera = dict(zip(("fx", "fy", "cx", "cy"), camera_of(WIDTH, HEIGHT), strict=True))
    spec = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), rate_hz=rate_hz, units=("mm",), meta={"camera": camera})
    background, persons, extrema = Background(), Persons(), Extrema()
    pose, footing = WholePose(up="-y"), Footing()
    person = persons.open({"in": background.open({"in": spec})["out"]})["out"]
    footing.open(dict(pose.open({"in": extrema.open({"in": person})["out"]})))
    performer, poses, joints, guessed = RenderedPerformer(WIDTH, HEIGHT), [], [], []
    for k, stamp in enumerate(grid(rate_hz, round(END_S * rate_hz)).tolist()):
        t = k / rate_hz
        frame = performer.frame(k, t)
        frame = scene(k, frame) if FROM_S <= t < UNTIL_S else frame
        chunk = Chunk(np.array([stamp]), np.ascontiguousarray(frame)[None], stamp)
        chunk = dict(background.process("in", chunk))["out"]
        chunk = dict(persons.process("in", chunk))["out"]
        chunk = dict(extrema.process("in", chunk))["out"]
        rows = Chunk(chunk.time, np.ascontiguousarray(chunk.data.reshape(1, -1)), chunk.until)
        made = dict(pose.process("in", rows))
        for port in ("joints", "quality"):
            footing.process(port, made[port])
        poses.append(dict(footing.process("pose", made["pose"]))["out"].data[0])
        joints.append(made["joints"].data[0])
        guessed.append(made["quality"].data[0, : len(BONES)].sum())
    return np.array(poses), np.array(joints), np.array(guessed)


@pytest.mark.parametrize(
    ("scene", "rate_hz"),
    [(s, 30.0) for s in (gone, moved, invalid, half, side, crossing, upside_down, noise)] + [(half, 10.0)],
    ids=lambda v: getattr(v, "__name__", f"{v:g} fps" if isinstance(v, float) else str(v)),
)
def test_a_degraded_scene_breaks_nothing(scene: Scene, rate_hz: float) -> None:
    poses, joints, guessed = through(scene, rate_hz)
    assert np.isfinite(poses).all() and np.isfinite(joints).all()
    turns = joints_of(usual_body(), poses)[0]
    cosines = np.abs((turns[1:] * turns[:-1]).sum(axis=-1)).clip(0.0, 1.0)
    assert 2 * np.arccos(cosines).max() * rate_hz <= 20.0 + 1e-3, "a bone turns too fast"
    after = joints[round(4.2 * rate_hz) :]  # calibrated by then
    lengths = np.linalg.norm(after[:, 1:] - after[:, NUMBERS[1:]], axis=2)
    assert (np.ptp(lengths, axis=0) <= 0.02 * lengths.mean(axis=0) + 1e-9).all(), "a bone's length changes"
    first, last = round(FROM_S * rate_hz), round(UNTIL_S * rate_hz)
    if scene in (gone, invalid, noise):
        assert guessed[first + 3 : last].min() >= 15, "not flagged"
        assert guessed[last + 10 :].min() < 15, "nobody is found again"
