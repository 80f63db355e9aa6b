"""`python -m bench.avatar_pictures -o FILE`: six moments of each left-out clip of bench.avatar_clips, what is sent beside the truth.

The moments are chosen by a rule: the middles of six equal parts of the clip. Both are drawn as the camera has them: the truth in grey, what
is sent beside it in blue, its guessed bones in orange.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from PIL import Image, ImageDraw

from bench.avatar_clips import FRAMES, LEFT_OUT, fused, given_out, posed, seen
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import BONES, PARENTS

MOMENTS, WIDE, HIGH, PIXELS = 6, 240, 200, 85.0
TRUE_BONES = ((1, 2), (1, 3), (3, 5), (2, 4), (4, 6), (7, 8), (1, 7), (2, 8), (7, 9), (9, 11), (8, 10), (10, 12))
"""Of the 13 true joints: head, shoulders, elbows, wrists, hips, knees, ankles."""
DRAWN = [(BONES.index(parent), b) for b, (bone, parent) in enumerate(PARENTS.items()) if parent and "Toes" not in bone]
GREY, BLUE, ORANGE = (130, 130, 130), (30, 90, 180), (225, 120, 20)


def moment(
    pen: ImageDraw.ImageDraw, corner: tuple[int, int], truth: Samples, joints: Samples, guessed: Samples
) -> None:
    """One moment: the truth (13, 3) and the joints (22, 3), y up, both about the true hips."""
    middle = 0.5 * (truth[7] + truth[8])

    def at(place: Samples, aside: float) -> tuple[float, float]:
        x, y = PIXELS * (place - middle)[:2]
        return corner[0] + aside * WIDE + float(x), corner[1] + 0.48 * HIGH - float(y)

    for a, b in TRUE_BONES:
        pen.line([at(truth[a], 0.27), at(truth[b], 0.27)], fill=GREY, width=4)
    x, y = at(truth[0], 0.27)
    pen.ellipse([x - 8, y - 8, x + 8, y + 8], fill=GREY)
    for a, b in DRAWN:
        pen.line([at(joints[a], 0.73), at(joints[b], 0.73)], fill=ORANGE if guessed[a] else BLUE, width=4)
    x, y = at(joints[BONES.index("Head")] + [0.0, 0.1, 0.0], 0.73)
    pen.ellipse([x - 8, y - 8, x + 8, y + 8], fill=ORANGE if guessed[BONES.index("Head")] else BLUE)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.avatar_pictures", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument(
        "--keep", type=Path, help="a folder for what cameras and networks gave, as of bench.avatar_clips"
    )
    given = parser.parse_args()
    folder = Path(os.environ["KINEGRAPH_DATA"]) / "body"
    sheet = Image.new("RGB", (MOMENTS * WIDE, len(LEFT_OUT) * HIGH), "white")
    pen = ImageDraw.Draw(sheet)
    for row, clip in enumerate(LEFT_OUT):
        shown = seen(folder, clip, given.keep)
        behind = fused(given_out(shown.ways["relief"]), given_out(shown.ways["extrema"]))
        markers = fused(given_out(shown.ways["network"], 0.01), behind)
        joints, _, flags = posed(markers, shown.ways["network"][1])
        for k in range(MOMENTS):
            frame = len(joints) - FRAMES + round(FRAMES * (k + 0.5) / MOMENTS)
            moment(pen, (k * WIDE, row * HIGH), shown.truth[frame] * [1.0, -1.0, -1.0], joints[frame], flags[frame])
        pen.text((6, row * HIGH + 4), f"{clip[1]} from {clip[2]}, {clip[3]} degrees", fill="black")
    sheet.quantize(16).save(given.out)
    print(f"{given.out}: {sheet.size[0]} x {sheet.size[1]}")


if __name__ == "__main__":
    main()
