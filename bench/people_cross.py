"""`python -m bench.people_cross`: does ImagePose stay with one person who leaves, comes back and is crossed by another; Markdown.

Minutes at 15 frames/s, put together from the rendered clips of KINEGRAPH_DATA (two bodies, cut out by their masks, in coloured clothes,
over a noisy room; 320 x 240). In each the first person moves on the spot, leaves at one side, is away for 4 s and comes back, walks to a
side and back; a second one crosses before, crosses behind, and stops beside. Where both are is known exactly. Each minute has another
motion. Needs `kinegraph files fetch camera-models`.
"""

from __future__ import annotations

import argparse
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from kinegraph.operators.body.camera.image_pose import ImagePose
from kinegraph.operators.body.camera.one_camera import OneCamera
from kinegraph.operators.body.names import LANDMARKS
from kinegraph.stream.chunk import NS, Chunk, StreamSpec

HEIGHT, WIDTH, FPS = 240, 320, 15
FIRST = ("walk_front", "punch_front", "jacks_front", "exercise_oblique", "hop_side")
SECOND = ("walk_front", "hop_side", "punch_front")
CLOTHES = (((60, 90, 230), (60, 60, 60)), ((220, 60, 50), (230, 220, 200)))
"""Upper and lower, of both people."""
HIPS = [LANDMARKS.index("left_hip"), LANDMARKS.index("right_hip")]
AWAY = 229.0
"""Pixels from its place at which a body is out of the image."""
MIN_SHOWN, MIN_HELD_S = 0.7, 0.5


@dataclass(frozen=True, slots=True)
class Person:
    """A clip: pictures (n, h, w), masks, and where the hips are (n, 2) in pixels."""

    pictures: np.ndarray
    masks: np.ndarray
    hips: np.ndarray

    @classmethod
    def of(cls, path: Path) -> Person:
        clip = np.load(path)
        ends, n = clip["ir_offsets"], len(clip["depth"])
        jpeg = clip["ir_jpeg"]
        pictures = np.array(
            [np.asarray(Image.open(io.BytesIO(jpeg[ends[i] : ends[i + 1]].tobytes())).convert("L")) for i in range(n)]
        )
        masks = np.unpackbits(clip["body_mask"], axis=1)[:, : HEIGHT * WIDTH].reshape(n, HEIGHT, WIDTH).astype(bool)
        names = clip["joint_names"].tolist()
        at = clip["joints"][:, [names.index("LeftUpLeg"), names.index("RightUpLeg")]].mean(1)
        fx, fy, cx, cy = clip["K"]
        return cls(pictures, masks, np.stack([fx * at[:, 0] / at[:, 2] + cx, fy * at[:, 1] / at[:, 2] + cy], 1))

    def shown(
        self, tick: int, across: float, scale: float, clothes: tuple[tuple[int, ...], ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Colours (h, w, 3), mask and hips, that many pixels to the right and `scale` times as large (feet stay near the floor)."""
        n = len(self.pictures)
        k = 2 * tick % (2 * n - 2)
        k = k if k < n else 2 * n - 2 - k
        hip = self.hips[k]
        floor = 200.0
        if abs(across) > AWAY:
            return np.zeros((HEIGHT, WIDTH, 3)), np.zeros((HEIGHT, WIDTH), bool), np.array([hip[0] + across, hip[1]])
        y, x = np.mgrid[:HEIGHT, :WIDTH]
        from_x = np.round((x - hip[0] - across) / scale + hip[0]).astype(int)
        from_y = np.round((y - floor) / scale + floor).astype(int)
        inside = (from_x >= 0) & (from_x < WIDTH) & (from_y >= 0) & (from_y < HEIGHT)
        from_x, from_y = np.clip(from_x, 0, WIDTH - 1), np.clip(from_y, 0, HEIGHT - 1)
        mask = self.masks[k][from_y, from_x] & inside
        light = np.clip(self.pictures[k][from_y, from_x].astype(float) / 70.0, 0.1, 1.2)
        upper, lower = (np.array(colour) for colour in clothes)
        colours = np.where((from_y < hip[1])[..., None], upper, lower) * light[..., None]
        skin = from_y < hip[1] - 45
        colours[skin] = np.array([225, 180, 150]) * light[skin][:, None]
        return np.clip(colours, 0, 255), mask, np.array([hip[0] + across, (hip[1] - floor) * scale + floor])


def between(t: float, *points: tuple[float, float]) -> float:
    return float(np.interp(t, [p[0] for p in points], [p[1] for p in points]))


def scene(
    begin: float, minutes: float, folder: Path
) -> Iterator[tuple[np.ndarray, np.ndarray, float, np.ndarray, float]]:
    """Pictures; hips of the first person and the share of that body in sight; of the second likewise."""
    clips = {name: Person.of(folder / f"{name}.npz") for name in {*FIRST, *SECOND}}
    random = np.random.default_rng(5)
    room = (
        90
        + 40 * np.linspace(0, 1, WIDTH)[None, :, None] * np.ones((HEIGHT, 1, 3))
        + random.normal(0, 6, (HEIGHT, WIDTH, 3))
    )
    room[200:] *= 0.6
    noise = random.normal(0, 5, room.shape)
    for tick in range(round(begin * 60 * FPS), round((begin + minutes) * 60 * FPS)):
        minute, t = divmod(tick / FPS, 60.0)
        side = 1 if int(minute) % 2 else -1
        first, second = clips[FIRST[int(minute) % len(FIRST)]], clips[SECOND[int(minute) % len(SECOND)]]
        across = side * between(t, (10, 0), (13, 230), (17, 230), (20, 0), (50, 0), (52, 80), (56, 80), (58, 0))
        one = first.shown(tick, across, 1.0, CLOTHES[0])
        far, scale, before = 400.0, 1.0, True
        if 24 <= t <= 29:
            far, scale = side * between(t, (24, -260), (29, 260)), 1.25
        elif 32 <= t <= 37:
            far, scale, before = side * between(t, (32, 260), (37, -260)), 0.85, False
        elif 40 <= t <= 48:
            far = side * between(t, (40, 260), (42.5, 70), (45, 70), (48, 260))
        two = second.shown(tick + 40, far, scale, CLOTHES[1])
        picture = room + np.roll(noise, (tick * 37) % HEIGHT, axis=0)
        shares = [1.0, 1.0]
        order = [(1, two), (0, one)] if not before else [(0, one), (1, two)]
        whole = [max(1, int((first if k == 0 else second).masks.sum(axis=(1, 2)).mean())) for k in range(2)]
        seen = np.full((HEIGHT, WIDTH), -1)
        for k, (colours, mask, _) in order:
            picture[mask] = colours[mask]
            seen[mask] = k
        shares = [float((seen == k).sum()) / (whole[k] * (scale**2 if k else 1.0)) for k in range(2)]
        yield np.clip(picture, 0, 255).astype(np.uint8), one[2], shares[0], two[2], shares[1]


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--begin", type=float, default=0.0, help="the first minute")
    given.add_argument("--minutes", type=float, default=10.0)
    given.add_argument("--keep", type=Path, help="a file for all numbers")
    chosen = given.parse_args()
    operator, placed = ImagePose(), OneCamera()
    camera = {"fx": 285.6, "fy": 285.6, "cx": 159.5, "cy": 119.5}
    seen = operator.open(
        {"in": StreamSpec((HEIGHT, WIDTH, 3), np.dtype(np.uint8), rate_hz=FPS, meta={"camera": camera})}
    )["out"]
    placed.open({"in": seen})
    rows, markers = [], []
    for tick, (picture, one, shown, two, other) in enumerate(
        scene(chosen.begin, chosen.minutes, Path(os.environ["KINEGRAPH_DATA"]) / "body" / "depth")
    ):
        stamp = np.array([NS + tick * NS // FPS])
        made = operator.process("in", Chunk(stamp, picture[None], int(stamp[0])))
        found = made.data[0]["points"][HIPS, :2].mean(0) if made.data[0]["presence"] >= 0.5 else np.full(2, np.nan)
        rows.append([tick / FPS, *found, *one, shown, *two, other])
        markers.append(placed.process("in", made)[0][1].data[0])
    if chosen.keep:
        np.savez(chosen.keep, rows=np.array(rows), markers=np.array(markers))
    report(np.array(rows), np.array(markers))


def report(rows: np.ndarray, markers: np.ndarray) -> None:
    t, found, one, shown, two, other = rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5], rows[:, 6:8], rows[:, 8]
    size = 60.0
    off, off_two = (np.linalg.norm(found - at, axis=1) / size for at in (one, two))
    there = shown >= MIN_SHOWN
    with_one, with_two = off < 0.35, (off_two < 0.35) & (off > 0.5) & (other > 0.3)
    held = round(MIN_HELD_S * FPS)
    exchanges = [run for run in runs(with_two & there) if run[1] - run[0] >= held]
    lost = [run for run in runs(there & ~with_one) if run[1] - run[0] >= held]
    returns = []
    for _, end in runs(shown < 0.05):
        if end < len(t):
            back = next((k for k in range(end, len(t)) if shown[k] >= 0.9), None)
            again = next((k for k in range(end, len(t)) if with_one[k]), None)
            if back is not None:
                returns.append((t[again] if again is not None else np.inf) - t[back])
    jumps = np.linalg.norm(np.diff(markers, axis=0), axis=2)
    sight, with_it = 100 * there.mean(), 100 * with_one[there].mean()
    print(f"{len(t) / FPS / 60:.1f} minutes; in sight for {sight:.0f} %, and followed for {with_it:.1f} % of that")
    for title, found_runs in (("exchanges", exchanges), ("not followed", lost)):
        at, long = [round(float(t[a]), 1) for a, _ in found_runs], sum(b - a for a, b in found_runs) / FPS
        print(f"{title} for {MIN_HELD_S} s and more: {len(found_runs)}, together {long:.1f} s; at {at} s")
    print(f"return: {np.round(sorted(returns), 2).tolist()} s after 90 % of the body is in the image")
    print(
        f"joints that jump by more than 1 m from frame to frame: {int((jumps > 1.0).sum())} in {int((jumps > 1.0).any(1).sum())} frames"
    )


def runs(true: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.r_[0, true.astype(int), 0]))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


if __name__ == "__main__":
    main()
