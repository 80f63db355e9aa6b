"""`python -m bench.body_starts`: for how long left and right of rendered bodies are exchanged, whichever frame is the first; Markdown.

Needs the folder that KINEGRAPH_DATA names, and the network (`kinegraph files fetch pose-model`). Clips of random parts of the motion
sequences, on both meshes, at headings all round, are rendered and looked at by the network once; the markers are made from every tenth
frame on, as if the person had stepped into view there. A flip is a frame in which exchanging left and right would be nearer to the truth by
5 cm; it is given out where at least a quarter of the 12 markers of limbs are not flagged. `--clips N`: how many; `--seed N`: others;
`--depth`: the relief of the depth instead of the infrared image.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.body import FAR_CM, FLAGGED, GOOD_CM, SHOWN, Chain, longest
from bench.body_render import CAMERA, Clip, studio
from kinegraph.operators.body.markers import Markers
from kinegraph.operators.body.names import SEEN
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import grid

HEADINGS = (0, 180, 90, 150, 30, 225, 270, 180, 300, 120)
VIEWS = ("front", "between", "side", "between", "back")
FRAMES, EVERY, LEAST, AFTER_S = 100, 10, 40, 20
EXCHANGED = [0, *(i for j in range(1, 13, 2) for i in (j + 1, j))]
GIVEN_SHARE, LONG = 0.25, 3


def clips(folder: Path, n: int, seed: int) -> Iterator[tuple[str, str, Clip]]:
    """View, name and clip: sequences and meshes in turn, random parts of them."""
    random = np.random.default_rng(seed)
    motion = np.load(folder / "cmu_mocap_30hz.npz")
    sequences = sorted(name[5:] for name in motion.files if name.startswith("root_"))
    for k in range(n):
        sequence, mesh, heading = sequences[k % len(sequences)], ("female", "male")[k % 2], HEADINGS[k % len(HEADINGS)]
        long = len(motion[f"root_{sequence}"])
        first = int(random.integers(max(long - FRAMES, 0) + 1))
        last = min(first + FRAMES, long)
        view = VIEWS[round(min(heading, 360 - heading) / 45)]
        yield (
            view,
            f"{mesh} {sequence} {first} to {last}, {heading}",
            studio(folder, mesh).clip(sequence, first, last, heading, seed=k),
        )


def seen(clip: Clip, *, depth_alone: bool) -> Any:
    """What the network sees of each frame (n,) SEEN."""
    chain = Chain(depth_alone=depth_alone)
    chain.markers = _Kept()  # type: ignore[assignment]
    chain.run(clip)
    return np.array(chain.markers.frames)[len(clip.empty) :]  # type: ignore[attr-defined]


class _Kept:
    """In the place of Markers in the chain: keeps what would be given to it."""

    def __init__(self) -> None:
        self.frames: list[Any] = []

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        self.frames.append(chunk.data[0].copy())
        nothing = Chunk(chunk.time, np.zeros((1, 20, 3)), chunk.until)
        return [("out", nothing), ("confidence", nothing)]


def markers(frames: Any, *, depth_alone: bool) -> tuple[Any, Any]:
    """Markers (n, 13, 3) and confidence (n, 13), without an earlier person."""
    operator = Markers(least=0.0, presence=0.0 if depth_alone else 0.5)
    camera = dict(zip(("fx", "fy", "cx", "cy"), CAMERA.tolist(), strict=True))
    operator.open({"in": StreamSpec((), SEEN, rate_hz=30.0, units=("px, m", "", ""), meta={"camera": camera})})
    times = grid(30.0, AFTER_S * 30 + len(frames))[AFTER_S * 30 :]
    made = dict(operator.process("in", Chunk(times, frames.copy(), int(times[-1]))))
    return made["out"].data[:, SHOWN], made["confidence"].data[:, SHOWN]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.body_starts", description=__doc__)
    parser.add_argument("--clips", type=int, default=50)
    parser.add_argument("--seed", type=int, default=18)
    parser.add_argument("--depth", action="store_true", help="no image: the relief of the depth")
    given = parser.parse_args()
    of: dict[str, list[tuple[Any, Any, int, int]]] = {}
    worst: list[tuple[int, int, str, int]] = []
    for view, name, clip in clips(Path(os.environ["KINEGRAPH_DATA"]) / "body", given.clips, given.seed):
        frames = seen(clip, depth_alone=given.depth)
        for start in range(0, max(len(frames) - LEAST, 0) + 1, EVERY):
            places, confidence = markers(frames[start:], depth_alone=given.depth)
            truth = clip.truth[start:]
            off = 100 * np.linalg.norm(places - truth, axis=2)
            flips = 100 * np.linalg.norm(places[:, EXCHANGED] - truth, axis=2).mean(1) + 5 < off.mean(1)
            out = flips & ((confidence[:, 1:] >= FLAGGED).mean(1) > GIVEN_SHARE)
            of.setdefault(view, []).append((off, confidence, longest(flips), longest(out)))
            worst.append((longest(flips), longest(out), name, start))
    print(
        "| view | starts | mean, cm | off by > 25 cm | of these flagged | of the good flagged | "
        "longest flip | longer than 3 | given out: longest | longer than 3 |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for view in ("front", "between", "side", "back"):
        print(row(view, of.get(view, [])))
    print(row("**all**", [one for made in of.values() for one in made]))
    print(
        "\nworst:",
        *(f"{flip}, given out {out}: {name}, from {start}" for flip, out, name, start in sorted(worst)[:-6:-1]),
        sep="\n",
    )


def row(view: str, made: list[tuple[Any, Any, int, int]]) -> str:
    if not made:
        return f"| {view} | 0 |"
    off, confidence = (np.concatenate([one[i] for one in made]) for i in (0, 1))
    flips, out = ([one[i] for one in made] for i in (2, 3))
    far, good, flagged = off > FAR_CM, off < GOOD_CM, (confidence < FLAGGED) | np.isnan(off)
    cells = [
        view, str(len(made)), f"{np.nanmean(off):.2f}", f"{100 * far.mean():.1f} %", f"{100 * flagged[far].mean():.0f} %",
        f"{100 * flagged[good].mean():.0f} %", str(max(flips)), str(sum(f > LONG for f in flips)), str(max(out)),
        str(sum(f > LONG for f in out)),
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
