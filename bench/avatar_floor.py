"""`python -m bench.avatar_floor`: whoever lies, kneels or sits on the floor, comes too near or turns round slowly, as the avatar has them.

Meshes as in bench/body_render.py. They stand for a second, go down within a second and stay there for another; then every joint of the
avatar counts as good that is within 20 cm of the true one, or flagged as guessed. `turning`: 120 degrees a second, once round; how many
frames in a row left and right of arms, legs and hips are exchanged. `near`: 1.3 m from the camera; in which frames legs alone are
guessed, so that the avatar turns to the upper body.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np

from bench.avatar_clips import STANDING, Seen, fused, given_out, posed
from bench.body import SHOWN, Chain, exchanged, longest
from bench.body_render import Clip, Studio, about_y, studio, truth_of
from kinegraph.operators.pose.footing import LEG_BONES, OTHERS
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES

DOWN, STAYS, WITHIN_M = 30, 30, 0.2
TURNED = 90
"""Frames of a turn by 360 degrees, at 30 Hz."""
JOINTS_OF = [
    BONES.index(f"{side}{bone}")
    for bone in ("UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
    for side in ("Left", "Right")
]
UP = np.array([1.0, -1.0, -1.0])


def about(axis: int, degrees: float) -> Any:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    made = np.eye(3)
    made[[a, a, b, b], [a, b, a, b]] = c, -s, s, c
    return made


def down(room: Studio, what: str, share: float) -> Any:
    """Rotations (31, 3, 3) of the bones of somebody who is on the way to what they do on the floor by this `share` of it."""
    turns = {name: np.eye(3) for name in room.names}

    def of(names: tuple[str, ...], turn: Any) -> None:
        for name in names:
            turns[name] = turn

    shanks = ("LeftLeg", "RightLeg", "LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase")
    legs = ("LHipJoint", "RHipJoint", "LeftUpLeg", "RightUpLeg", *shanks)
    if what == "kneels":
        of(shanks, about(0, 90 * share))
    elif what == "sits":
        of(legs, about(0, -85 * share))
    elif what == "sits cross-legged":
        of(shanks, about(0, 20 * share))
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            of((f"{side}UpLeg",), about(1, 40 * sign * share) @ about(0, -80 * share))
            of((f"{side}Leg", f"{side}Foot", f"{side}ToeBase"), about(1, -50 * sign * share) @ about(0, -80 * share))
    else:
        of(tuple(room.names), about(2, 90 * share) if what == "lies across" else about(0, -88 * share))
    return np.stack([turns[name] for name in room.names])


def placed(room: Studio, rotations: Any, degrees: float, ahead_m: float) -> tuple[Any, Any]:
    """The same (n, 31, 3, 3) turned by `degrees`, and joints (n, 31, 3): the lowest point of the skin on the floor."""
    rotations = about_y(np.radians(degrees)) @ rotations
    head, hips = room.body["head"].astype(float), room.names.index("Hips")
    joints = np.full((len(rotations), 31, 3), np.nan)
    joints[:, hips] = 0.0
    while np.isnan(joints).any():
        for j, p in enumerate(room.body["parents"]):
            if j != hips and not np.isnan(joints[0, p]).any():
                joints[:, j] = joints[:, p] + rotations[:, p] @ (head[j] - head[p])
    for turns, places in zip(rotations, joints, strict=True):
        places[:, 1] -= room.skin(turns, places)[:, 1].min()
        places[:, 2] += ahead_m
    return rotations, joints


def seen_by_all(room: Studio, rotations: Any, joints: Any) -> Seen:
    random = np.random.default_rng(0)
    frames = [room.frame(r, j, random) for r, j in zip(rotations, joints, strict=True)]
    empty = np.stack([room._seen(room.room, np.zeros_like(room.room), random) for _ in range(40)])
    tails = joints + np.einsum("nkij,kj->nki", rotations, (room.body["tail"] - room.body["head"]).astype(float))
    truth = truth_of(room.names, *((x - room.place) @ room.axes.T for x in (joints, tails)))
    clip = Clip(np.stack([f[0] for f in frames]), np.stack([f[1] for f in frames]), empty, truth)
    ways = {
        "network": Chain(depth_alone=False).run(clip),
        "relief": Chain(depth_alone=True).run(clip),
        "extrema": Chain(depth_alone=True, geodesic=True).run(clip),
    }
    return Seen(ways, truth, truth[:, 0])


def avatars(shown: Seen) -> dict[str, tuple[Samples, Samples, Samples]]:
    """Markers, joints and which bones are guessed: with the network, and by depth alone."""
    behind = fused(given_out(shown.ways["relief"]), given_out(shown.ways["extrema"]))
    raw = shown.ways["network"]
    made = {}
    for way, markers, given, sure in (
        ("network", fused(given_out(raw, 0.01), behind), fused(given_out(raw), behind), raw[1]),
        ("depth alone", behind, behind, np.ones(behind.shape[:2])),
    ):
        joints, _, flags = posed(markers, sure)
        made[way] = given, joints, flags
    return made


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.avatar_floor", description=__doc__)
    parser.add_argument("--mesh", choices=("male", "female"), default="female")
    parser.add_argument("--only", default="", help="what the scene's name begins with")
    given = parser.parse_args()
    room = studio(Path(os.environ["KINEGRAPH_DATA"]) / "body", given.mesh)
    print("| scene | way | joints cm, median | within 20 cm | flagged | one of both | exchanged: arms / legs / hips |")
    print("|---|---|---|---|---|---|---|")
    upright = np.repeat(np.eye(3)[None, None], 31, axis=1)
    share = np.r_[np.zeros(STANDING), np.linspace(0.0, 1.0, DOWN), np.ones(STAYS)]
    scenes: dict[str, tuple[Any, Any]] = {}
    for what in ("lies across", "sits", "lies, feet to the camera", "kneels", "sits cross-legged"):
        if what.startswith(given.only):
            scenes[what] = placed(room, np.stack([down(room, what, s) for s in share]), 0.0, 0.0)
    if "turning".startswith(given.only):
        angles = np.r_[np.zeros(STANDING), np.arange(0.0, 360.0, 360.0 / TURNED), np.zeros(STAYS)]
        rows = [placed(room, upright, a, 0.0) for a in angles]
        scenes["turning"] = np.concatenate([r for r, _ in rows]), np.concatenate([j for _, j in rows])
    if "near".startswith(given.only):
        away = np.r_[np.zeros(STANDING), np.linspace(0.0, 1.6, DOWN), np.full(STAYS, 1.6)]
        rows = [placed(room, upright, 0.0, a) for a in away]
        scenes["near"] = np.concatenate([r for r, _ in rows]), np.concatenate([j for _, j in rows])
    for name, (rotations, joints) in scenes.items():
        shown = seen_by_all(room, rotations, joints)
        at = slice(STANDING, None) if name == "turning" else slice(-STAYS, None)
        for way, (markers, made, flags) in avatars(shown).items():
            off = np.linalg.norm(made[at][:, JOINTS_OF] - shown.truth[at][:, 1:] * UP, axis=2)
            near, flagged = off < WITHIN_M, flags[at][:, JOINTS_OF] > 0.0
            swapped = [longest(f) for f in exchanged(markers[at][:, SHOWN], shown.truth[at]).values()]
            cells = [
                f"{100 * np.median(off):.0f}",
                *(f"{100 * x.mean():.0f} %" for x in (near, flagged, near | flagged)),
            ]
            if name == "near":
                upper = np.asarray(flags[at][:, LEG_BONES].all(axis=1) & ~flags[at][:, OTHERS].all(axis=1))
                print(
                    f"{way}: legs alone are guessed in {100 * upper.mean():.0f} % of the frames, for {longest(upper)} in a row"
                )
            print(f"| {name} | {way} |", " | ".join(cells), f"| {' / '.join(map(str, swapped))} |", flush=True)


if __name__ == "__main__":
    main()
