"""`python -m bench.body`: how far the markers of operators.body are from the truth on rendered bodies; Markdown.

Needs the folder that KINEGRAPH_DATA names, and the network (`kinegraph files fetch pose-model`). 13 markers of every frame count: head,
shoulders, elbows, wrists, hips, knees, ankles; those that are flagged too. A flip is a frame in which left and right of arms,
legs or hips, each by itself, would be nearer to the truth exchanged. `--depth`: the relief of the depth instead of the infrared image.
`--geodesic`: no network either, operators.body.extrema. `--every N`: every N-th frame.
"""

from __future__ import annotations

import argparse
import io
import os
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image

from bench.body_render import CAMERA, Clip, studio, truth_of
from kinegraph.operators.body.background import Background
from kinegraph.operators.body.extrema import Extrema
from kinegraph.operators.body.markers import Markers
from kinegraph.operators.body.names import MARKERS
from kinegraph.operators.body.network.operator import PoseNetwork
from kinegraph.operators.body.network.relief import Relief
from kinegraph.operators.body.persons import Persons
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import grid

DEV = (
    "walk_front",
    "punch_front",
    "wash_front",
    "jacks_front",
    "exercise_front",
    "bend_front",
    "exercise_oblique",
    "hop_side",
)
OTHERS = (
    ("14_14", 700, 800, 0), ("02_01", 0, 80, 0), ("13_29", 500, 600, 0), ("01_05", 300, 400, 0),
    ("14_14", 700, 800, 90), ("13_29", 100, 200, 90), ("01_05", 300, 400, 90),
    ("02_01", 0, 80, 180), ("13_29", 100, 200, 180), ("01_05", 300, 400, 180),
)  # fmt: skip
"""Sequences that nothing was tuned or trained on, on the mesh that nothing was trained on: frontal, from the side, from behind."""
SHOWN = [
    MARKERS.index(f"{side}{name}")
    for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left_", "right_")
]
SHOWN = [MARKERS.index("head"), *SHOWN]
PARTS = {
    "arms": ("shoulder", "elbow", "wrist"),
    "legs": ("knee", "ankle"),
    "hips": ("hip",),
}
FLAGGED, FAR_CM, GOOD_CM = 0.5, 25.0, 10.0
VIEWS = {0: "front", 90: "side", 180: "back"}


def recorded(folder: Path, name: str) -> Clip:
    """A clip of the folder."""
    z = np.load(folder / "depth" / f"{name}.npz")
    at, data = z["ir_offsets"], z["ir_jpeg"]
    images = [np.asarray(Image.open(io.BytesIO(data[a:b].tobytes()))) for a, b in pairwise(at)]
    truth = truth_of([str(n) for n in z["joint_names"]], z["joints"], z["tails"])
    return Clip(z["depth"], np.stack(images), np.repeat(z["background"][None], 40, 0), truth)


class Chain:
    """Depth and infrared in, markers and confidence out, as a graph has them; the processor time of each frame (ms)."""

    def __init__(self, *, depth_alone: bool, geodesic: bool = False) -> None:
        shape = (240, 320)
        camera = dict(zip(("fx", "fy", "cx", "cy"), CAMERA.tolist(), strict=True))
        depth = StreamSpec(shape, np.dtype(np.uint16), rate_hz=30.0, units=("mm",), meta={"camera": camera})
        self.background, self.persons, self.relief = Background(), Persons(), Relief() if depth_alone else None
        self.network, self.markers = PoseNetwork(), Markers(least=0.0, presence=0.0 if depth_alone else 0.5)
        person = self.persons.open({"in": self.background.open({"in": depth})["out"]})["out"]
        self.costs: dict[str, list[float]] = {"background": [], "persons": [], "network": [], "markers": []}
        self.extrema = Extrema() if geodesic else None
        if self.extrema:
            self.extrema.open({"in": depth})
            return
        image = (
            self.relief.open({"in": person})["out"]
            if self.relief
            else StreamSpec(shape, np.dtype(np.uint8), rate_hz=30.0)
        )
        self.markers.open({"in": self.network.open({"image": image, "person": person})["out"]})

    def run(self, clip: Clip) -> tuple[np.ndarray, np.ndarray]:
        """Markers (n, 20, 3) and confidence (n, 20)."""
        times = grid(30.0, len(clip.empty) + len(clip.depth))
        frames = [
            *((d, np.zeros_like(clip.infrared[0])) for d in clip.empty),
            *zip(clip.depth, clip.infrared, strict=True),
        ]
        made = [self._frame(int(t), d, image) for t, (d, image) in zip(times, frames, strict=True)][len(clip.empty) :]
        return np.stack([m for m, _ in made]), np.stack([c for _, c in made])

    def _frame(self, stamp: int, depth: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at = [time.thread_time()]
        stamps = np.array([stamp])
        before = dict(self.background.process("in", Chunk(stamps, depth[None], stamp)))["out"]
        at.append(time.thread_time())
        person = dict(self.persons.process("in", before))["out"]
        at.append(time.thread_time())
        if self.extrema:
            at.append(time.thread_time())
            made = dict(self.extrema.process("in", person))
        else:
            seen = self.relief.process("in", person) if self.relief else Chunk(stamps, image[None], stamp)
            self.network.process("image", seen)
            landmarks = self.network.process("person", person)[-1][1]
            at.append(time.thread_time())
            made = dict(self.markers.process("in", landmarks))
        at.append(time.thread_time())
        for name, cost in zip(self.costs, np.diff(at) * 1e3, strict=True):
            self.costs[name].append(float(cost))
        return made["out"].data[0], made["confidence"].data[0]


def longest(flags: np.ndarray) -> int:
    """Of flags (n,): the most in a row."""
    best = run = 0
    for flag in flags:
        run = run + 1 if flag else 0
        best = max(best, run)
    return best


def exchanged(markers: np.ndarray, truth: np.ndarray) -> dict[str, np.ndarray]:
    """By part: the frames (n,) in which its left and right exchanged are nearer to the truth by 5 cm; what is missing does not count."""
    names, found = [MARKERS[k] for k in SHOWN], dict[str, np.ndarray]()
    for part, joints in PARTS.items():
        left = [names.index(f"left_{j}") for j in joints]
        right = [names.index(f"right_{j}") for j in joints]
        both = left + right
        there = np.isfinite(markers[:, both]).all(axis=2)
        as_is = np.linalg.norm(markers[:, both] - truth[:, both], axis=2)
        other = np.linalg.norm(markers[:, both] - truth[:, right + left], axis=2)
        count = np.maximum(there.sum(axis=1), 1)
        mean = [np.where(there, d, 0.0).sum(axis=1) / count for d in (as_is, other)]
        found[part] = mean[1] + 0.05 < mean[0]
    return found


def clips(folder: Path, every: int) -> Iterator[tuple[str, str, Clip]]:
    for name in DEV:
        yield "dev", name, recorded(folder, name)
    for sequence, first, last, degrees in OTHERS:
        yield (
            f"other, {VIEWS[degrees]}",
            f"{sequence} {VIEWS[degrees]}",
            studio(folder, "female").clip(sequence, first, last, degrees),
        )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.body", description=__doc__)
    parser.add_argument("--depth", action="store_true", help="no image: the relief of the depth")
    parser.add_argument("--geodesic", action="store_true", help="no network: geodesic extrema of the depth")
    parser.add_argument("--only", nargs="+", default=(), help="these clips")
    parser.add_argument("--every", type=int, default=1)
    given = parser.parse_args()
    folder = Path(os.environ["KINEGRAPH_DATA"]) / "body"
    print(
        "| clip | mean, cm | median | given ones' mean | off by > 25 cm | of these flagged | of the good flagged | flips | longest | lost |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    groups: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    costs: dict[str, list[float]] = {}
    for group, name, clip in clips(folder, given.every):
        if given.only and name not in given.only:
            continue
        chain = Chain(depth_alone=given.depth, geodesic=given.geodesic)
        k = slice(None, None, given.every)
        clip = Clip(clip.depth[k], clip.infrared[k], clip.empty, clip.truth[k])
        markers, confidence = (made[:, SHOWN] for made in chain.run(clip))
        off = 100 * np.linalg.norm(markers - clip.truth, axis=2)
        flips = np.any(list(exchanged(markers, clip.truth).values()), axis=0)
        result = (float(np.mean(flips)), longest(flips))
        print(row(name, off, confidence, result), flush=True)
        for names in (group, "dev, front" if name in DEV[:6] else ""):
            groups.setdefault(names, []).append((off, confidence))
        for part, times in chain.costs.items():
            costs.setdefault(part, []).extend(times[len(clip.empty) :])
    for group, found in groups.items():
        if group:
            print(
                row(f"**{group}**", np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found]), None)
            )
    print(
        "\nms of processor time a frame, median and 99 %:",
        ", ".join(f"{p} {np.median(t):.2f} / {np.quantile(t, 0.99):.2f}" for p, t in costs.items()),
    )


def row(name: str, off: np.ndarray, confidence: np.ndarray, flips: tuple[float, int] | None) -> str:
    far, good, flagged = off > FAR_CM, off < GOOD_CM, (confidence < FLAGGED) | np.isnan(off)
    cells = [
        name, f"{np.nanmean(off):.1f}", f"{np.nanmedian(off):.1f}", f"{off[~flagged].mean():.1f}", f"{100 * far.mean():.1f} %",
        f"{100 * flagged[far].mean():.0f} %" if far.any() else "-", f"{100 * flagged[good].mean():.0f} %",
        f"{100 * flips[0]:.0f} %" if flips else "", str(flips[1]) if flips else "", f"{100 * np.isnan(off).mean():.1f} %",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
