"""`python -m bench.avatar_clips`: what the avatar of `configs/parts/avatar.yaml` looks like beside the truth, clip by clip; Markdown.

Rendered bodies as in bench/body.py: two meshes, ten motion sequences, from the front, the side, behind and 30 degrees to either side. Each
clip begins with a second of standing, as `avatar` asks for. Rules and constants were chosen on the clips "chosen on"; "left out" has other
motions on the other mesh. `--keep FOLDER` keeps what cameras and networks gave, so that only the chain after them runs again.

jitter     mean second difference of the limbs' directions, over the truth's
limbs      degrees between a limb and the true one, mean; head: pitch of the head against the true one, 95 %
turn       degrees a frame by which a limb turns, beside the truth
exchanged  of arms, legs and hips each: the frames in which left and right exchanged would be 5 cm nearer; the most in a row
far        of the markers off by more than 25 cm, before or after `Surer`, those not given out so: missing, flagged, or replaced by a near
           one; the most frames in a row in which one is given out
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.body import FAR_CM, SHOWN, Chain, exchanged, longest
from bench.body_render import Clip, Studio, about_y, studio, truth_of
from kinegraph.operators.body.marker_fusion import Surer
from kinegraph.operators.body.names import markers_specs
from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.operators.pose.operator import WholePose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.operator import grid

FRAMES, STANDING = 80, 40
PEOPLE = Path("people")
CHOSEN_ON = (
    ("male", "02_05", 120, 0), ("male", "01_02", 500, 30), ("male", "02_08", 100, -30), ("male", "13_31", 300, 0),
    ("male", "02_10", 200, 30), ("male", "01_10", 400, 90), ("male", "02_06", 250, 0), ("male", "03_03", 500, 180),
)  # fmt: skip
LEFT_OUT = (
    ("female", "13_29", 600, 0), ("female", "14_14", 300, 30), ("female", "01_05", 300, 0), ("female", "02_01", 0, 180),
    ("female", "13_29", 200, -30), ("female", "01_08", 200, 90), ("female", "14_14", 700, 0), ("female", "01_13", 300, 20),
)  # fmt: skip
LIMBS = tuple((f"{s}{a}", f"{s}{b}") for s in ("Left", "Right") for a, b in (
    ("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")))  # fmt: skip
TRUE_LIMBS = tuple((i, i + 2) for side in range(2) for i in (1 + side, 3 + side, 7 + side, 9 + side))
"""The same of the 13 true joints."""


@dataclass(frozen=True, slots=True)
class Seen:
    """A clip as three ways see it: markers (n, 20, 3) and confidence (n, 20) of each; the truth (n, 13, 3), and the head's front (n, 3)."""

    ways: dict[str, tuple[Samples, Samples]]
    truth: Samples
    front: Samples


def rendered(room: Studio, sequence: str, first: int, degrees: float) -> tuple[Clip, Samples]:
    """A clip that begins with standing still in the first pose's place, arms down, as `standing`; and where the head faces (n, 3)."""
    rotations, joints = room.poses(sequence, first, min(first + FRAMES, len(room.motion[f"root_{sequence}"])), degrees)
    stand, placed = standing(room, joints[0], degrees)
    rotations, joints = np.concatenate([stand, rotations]), np.concatenate([placed, joints])
    random = np.random.default_rng(0)
    frames = [room.frame(r, j, random) for r, j in zip(rotations, joints, strict=True)]
    empty = np.stack([room._seen(room.room, np.zeros_like(room.room), random) for _ in range(40)])
    tails = joints + np.einsum("nkij,kj->nki", rotations, (room.body["tail"] - room.body["head"]).astype(float))
    places = [(x - room.place) @ room.axes.T for x in (joints, tails)]
    truth = truth_of(room.names, places[0], places[1])
    front = rotations[:, room.names.index("Head"), :, 2] @ room.axes.T
    return Clip(np.stack([f[0] for f in frames]), np.stack([f[1] for f in frames]), empty, truth), front


def standing(room: Studio, joints: Any, degrees: float) -> tuple[Any, Any]:
    """The mesh at rest (arms out and down) where `joints` (31, 3) are: STANDING frames of standing as the clip is turned, or facing the
    camera and then turning, at 3 degrees a frame, where that shows the side or the back."""
    turning = np.arange(0.0, degrees, 3.0) if abs(degrees) > 60 else []
    angles = np.concatenate([np.full(STANDING, 0.0 if len(turning) else degrees), turning])
    hips = room.names.index("Hips")
    rest = room.body["head"].astype(float) - room.body["head"][hips] * [1, 0, 1]
    turns = np.stack([about_y(np.radians(angle)) for angle in angles])
    return np.repeat(turns[:, None], 31, axis=1), rest @ turns.transpose(0, 2, 1) + joints[hips] * [1, 0, 1]


def seen(folder: Path, clip: tuple[str, str, int, int], keep: Path | None) -> Seen:
    mesh, sequence, first, degrees = clip
    kept = keep / f"{mesh}-{sequence}-{first}-{degrees}.npz" if keep else None
    if kept and kept.is_file():
        z = np.load(kept)
        return Seen(
            {way: (z[f"{way}_markers"], z[f"{way}_confidence"]) for way in z["ways"].tolist()}, z["truth"], z["front"]
        )
    picture, front = rendered(studio(folder, mesh), sequence, first, degrees)
    ways = {
        "network": Chain(depth_alone=False).run(picture),
        "relief": Chain(depth_alone=True).run(picture),
        "extrema": Chain(depth_alone=True, geodesic=True).run(picture),
    }
    if kept:
        arrays = {
            f"{way}_{name}": a
            for way, pair in ways.items()
            for name, a in zip(("markers", "confidence"), pair, strict=True)
        }
        np.savez_compressed(kept, ways=np.array(list(ways)), truth=picture.truth, front=front, **arrays)
    return Seen(ways, picture.truth, front)


def given_out(made: tuple[Samples, Samples], least: float = 0.5) -> Samples:
    markers, confidence = made
    return np.where((confidence < least)[..., None], np.nan, markers)


def fused(first: Samples, second: Samples) -> Samples:
    """`first` and `second` (n, 20, 3) through Surer."""
    surer, spec, times = Surer(), spec_of_markers(), grid(30.0, len(first))
    surer.open({"first": spec, "second": spec})
    out = []
    for i, time in enumerate(times.tolist()):
        surer.process("second", Chunk(times[i : i + 1], second[i : i + 1], time))
        out.append(surer.process("first", Chunk(times[i : i + 1], first[i : i + 1], time)).data)  # type: ignore[union-attr]
    return np.concatenate(out)


def spec_of_markers() -> StreamSpec:
    return markers_specs(StreamSpec((240, 320), np.dtype(np.uint16), rate_hz=30.0, units=("mm",)))["out"]


def posed(markers: Samples, confidence: Samples, *, model: Path | None = PEOPLE) -> tuple[Samples, Samples, Samples]:
    """Joints (n, 22, 3), y up, world rotations (n, 22, 4) and what is guessed (n, 22), of markers (n, 20, 3) of this confidence."""
    spec, times, smooth = spec_of_markers(), grid(30.0, len(markers)), OneEuro(cutoff_hz=1.0, beta=10.0)
    smooth.open({"in": spec})
    chunk = smooth.process("in", Chunk(times, markers, int(times[-1])))
    assert isinstance(chunk, Chunk)
    pose = WholePose(up="-y", model=model, follow_hz=1.65)
    poses, joints, flags = np.empty((len(times), 91)), np.empty((len(times), 22, 3)), np.empty((len(times), 22))
    pose.open({"in": spec, "confidence": StreamSpec(confidence.shape[1:], rate_hz=30.0)})
    for i, time in enumerate(times.tolist()):
        pose.process("confidence", Chunk(times[i : i + 1], confidence[i : i + 1], time))
        out = dict(pose.process("in", Chunk(times[i : i + 1], chunk.data[i : i + 1].reshape(1, -1), time)))
        poses[i], joints[i], flags[i] = out["pose"].data[0], out["joints"].data[0], out["quality"].data[0, :22]
    turns, _ = joints_of(usual_body(), poses)
    return joints, turns, flags


def directions(joints: Samples, limbs: Iterable[tuple[int, int]]) -> Samples:
    v = np.stack([joints[:, b] - joints[:, a] for a, b in limbs], axis=1)
    return np.asarray(v / np.linalg.norm(v, axis=2, keepdims=True))


def angles(a: Samples, b: Samples) -> Samples:
    return np.asarray(np.degrees(np.arccos(np.clip((a * b).sum(-1), -1.0, 1.0))))


def second(x: Samples) -> float:
    return float(np.linalg.norm(np.diff(x, n=2, axis=0), axis=-1).mean())


def turned_by(turns: Samples) -> Samples:
    """Degrees by which each rotation (n, 22, 4) turns from one frame to the next."""
    return np.asarray(2 * np.degrees(np.arccos(np.clip(np.abs((turns[1:] * turns[:-1]).sum(-1)), 0.0, 1.0))))


def pitch(front: Samples) -> Samples:
    return np.asarray(np.degrees(np.arcsin(np.clip(front[..., 1], -1, 1))))


def judged(
    markers: Samples, all_of_them: tuple[Samples, Samples] | None, clip: Seen, doubtful: Samples | None = None
) -> dict[str, float]:
    """What a row of the table says of these `markers` (n, 20, 3), as given out; `doubtful` are all that the pose is given of them."""
    at = slice(-FRAMES, None)
    shown, truth = markers[at][:, SHOWN], clip.truth[at]
    made: dict[str, float] = {}
    for part, flags in exchanged(shown, truth).items():
        made[part] = longest(flags)
    off = 100 * np.linalg.norm(shown - truth, axis=2)
    made["markers cm"] = float(np.nanmean(off))
    made["far flagged"] = np.nan
    if all_of_them is not None:
        raw = 100 * np.linalg.norm(all_of_them[0][at][:, SHOWN] - truth, axis=2)
        far = (raw > FAR_CM) | (off > FAR_CM)
        made["far flagged"] = 100.0 - float(100 * (off[far] > FAR_CM).mean()) if far.any() else np.nan
    made["far in a row"] = max(longest(flags) for flags in (off > FAR_CM).T)
    made["missing %"] = float(100 * np.isnan(off).mean())
    confidence = np.ones(markers.shape[:2]) if all_of_them is None else all_of_them[1]
    joints, turns, _ = posed(markers if doubtful is None else doubtful, confidence)
    up = np.array([1.0, -1.0, -1.0])
    limbs = directions(joints[at], [(BONES.index(a), BONES.index(b)) for a, b in LIMBS])
    true = directions(truth * up, TRUE_LIMBS)
    made["limbs deg"] = float(angles(limbs, true).mean())
    made["jitter"] = second(limbs) / second(true)
    thirteen = joints[at][:, [BONES.index(n) for n in (
        "LeftUpperArm", "RightUpperArm", "LeftLowerArm", "RightLowerArm", "LeftHand", "RightHand", "LeftUpperLeg", "RightUpperLeg",
        "LeftLowerLeg", "RightLowerLeg", "LeftFoot", "RightFoot")]]  # fmt: skip
    made["joints cm"] = float(100 * np.linalg.norm(thirteen - truth[:, 1:] * up, axis=2).mean())
    limb_bones = [BONES.index(a) for a, _ in LIMBS]
    made["turn"] = float(turned_by(turns[at])[:, limb_bones].mean())
    made["true turn"] = float(angles(true[1:], true[:-1]).mean())
    head = turns[at][:, BONES.index("Head")]
    w, x, y, z = np.moveaxis(head, -1, 0)
    front = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    made["head 95 %"] = float(np.percentile(np.abs(pitch(front) - pitch(clip.front[at] * up)), 95))
    return made


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.avatar_clips", description=__doc__)
    parser.add_argument("--keep", type=Path, help="a folder for what cameras and networks gave")
    parser.add_argument("--only", choices=("chosen on", "left out"))
    given = parser.parse_args()
    folder = Path(os.environ["KINEGRAPH_DATA"]) / "body"
    rows: dict[tuple[str, str], list[dict[str, float]]] = {}
    for group, clips in (("chosen on", CHOSEN_ON), ("left out", LEFT_OUT)):
        if given.only not in (None, group):
            continue
        for clip in clips:
            shown = seen(folder, clip, given.keep)
            out = {way: given_out(made) for way, made in shown.ways.items()}
            every = given_out(shown.ways["network"], 0.01)
            behind = fused(out["relief"], out["extrema"])
            chains = {
                "network, relief": (fused(out["network"], behind), shown.ways["network"], fused(every, behind)),
                "the same, without doubtful ones": (fused(out["network"], behind), shown.ways["network"], None),
                "depth alone": (behind, None, None),
                "depth alone, no network": (out["extrema"], None, None),
            }
            for way, (markers, raw, doubtful) in chains.items():
                result = judged(markers, raw, shown, doubtful)
                if not rows:
                    print("| clip | way |", " | ".join(result), "|\n|---|---|" + "---|" * len(result))
                rows.setdefault((group, way), []).append(result)
                print(
                    f"| {' '.join(map(str, clip))} | {way} |",
                    " | ".join(f"{v:.1f}" for v in result.values()),
                    "|",
                    flush=True,
                )
    for (group, way), found in rows.items():
        worst = {"arms", "legs", "hips", "far in a row"}
        cells = [(max if k in worst else np.nanmean)([r.get(k, np.nan) for r in found]) for k in found[0]]
        print(f"| **{group}** | {way} |", " | ".join(f"{v:.1f}" for v in cells), "|")


if __name__ == "__main__":
    main()
