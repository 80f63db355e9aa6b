"""`python -m bench.pictures docs/pictures/simplified.png`: a face in relief as measured and as simplified (thesis, 4.3).

Prints the share of the relief's detail finer than a block that is left, by the number of components.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from bench.sleep import BLOCK, frames, learned
from kinegraph.stream.chunk import NS, Array, Chunk

MIDDLE = (87, 320)
"""Where the sleeper's head is in frames of 640 x 480: row, column."""
PANELS = {0: "as measured", 16: "16 components", 2: "2 components", 1: "1 component (default)"}


def face(height: int, width: int, row: int, column: int) -> Array:
    """A relief as large as a face at 2 m: nose, eyes, brows and lips on a dome; mm towards the camera."""
    y, x = np.mgrid[0:height, 0:width].astype(float)

    def bump(dx: float, dy: float, wide: float, high: float) -> Array:
        return np.exp(-(((x - column - dx) / wide) ** 2) - ((y - row - dy) / high) ** 2)

    features = 25 * bump(0, 2, 3, 6) - 8 * bump(0, 14, 7, 2) + 8 * bump(0, 11, 6, 2)
    for side in (-9, 9):
        features += 10 * bump(side, -11, 6, 1.5) - 14 * bump(side, -6, 4, 3)
    return features + 40 * bump(0, 0, 20, 26)


def finer(frame: Array) -> float:
    """The energy of what a frame holds beside the level of each block."""
    height, width = frame.shape
    blocks = frame.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)
    return float(((blocks - blocks.mean(axis=1, keepdims=True)) ** 2).sum())


def simplified(seen: Array, components: int) -> Array:
    """Frames (n, h, w) as the operator gives them, its basis learned; as they are for 0 components."""
    if not components:
        return seen.astype(float)
    operator, _ = learned(seen, components)
    time = np.arange(len(seen)) * (NS // 30) + 2 * 10**18
    out: Array = operator.process("in", Chunk(time, seen, int(time[-1])))[1][1].data.astype(float)
    return out


def main() -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    plain = frames(64)
    relief = face(*plain.shape[1:], *MIDDLE)
    seen = np.where(plain > 0, plain - relief, 0).astype(np.uint16)
    figure, axes = pyplot.subplots(1, len(PANELS), figsize=(9, 3.4))
    top, left = MIDDLE[0] - 31, MIDDLE[1] - 24
    for axis, (components, title) in zip(axes, PANELS.items(), strict=True):
        shown = simplified(seen, components)
        if components:
            left_over = finer((simplified(plain, components) - shown).mean(axis=0)) / finer(relief)
            print(f"{components} components: {left_over:.1%} of what is finer than a block")
        part = shown[0, top : top + 64, left : left + 48]
        axis.imshow(np.where(part > 0, part, np.nan), cmap="gray_r", vmin=1785, vmax=1885)
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
    figure.tight_layout()
    figure.savefig(Path(sys.argv[1]), dpi=70)


if __name__ == "__main__":
    main()
