"""A person's depth lit from the side, against its definition in plain loops."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.operators.body.network.relief import GREY, Relief
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.operator import grid


def lit(frame: Any, reach: int) -> Any:
    """The relief of one frame (h, w) in mm, slowly."""
    h, w = frame.shape
    d = frame.astype(float)
    smooth = np.zeros((h, w))
    for y, x in np.argwhere(frame):
        near = d[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
        smooth[y, x] = near[(near > 0) & (abs(near - d[y, x]) < 80.0)].mean()
    out = np.full((h, w), GREY, np.uint8)
    for y, x in np.argwhere(frame):
        if 0 < y < h - 1 and 0 < x < w - 1:
            at = smooth[y, x]
            right, left, under, over = (
                v or at for v in (smooth[y, x + 1], smooth[y, x - 1], smooth[y + 1, x], smooth[y - 1, x])
            )
            p, q = (right - left) / (at / 140.0), (under - over) / (at / 140.0)
            bright = (0.8 + 0.5 * p + 0.35 * q) / np.sqrt(1.0 + p * p + q * q)
            out[y, x] = np.uint8(np.clip(60.0 + 150.0 * bright, 1.0, 255.0))
    return out


def relief(frames: Any, reach: int) -> Any:
    operator = Relief(reach=reach)
    operator.open({"in": StreamSpec(frames.shape[1:], np.dtype(np.uint16), rate_hz=30.0, units=("mm",))})
    time = grid(30.0, len(frames))
    made = operator.process("in", Chunk(time, frames, int(time[-1])))
    assert isinstance(made, Chunk)
    return made.data


def test_a_relief_is_that_of_the_plain_loops() -> None:
    rng = np.random.default_rng(3)
    bumps = 60.0 * np.sin(np.arange(24)[:, None] / 3.0) * np.cos(np.arange(32) / 4.0)
    frames = (2000.0 + bumps + rng.normal(0.0, 15.0, (2, 24, 32))).astype(np.uint16)
    frames[:, :3] = frames[:, 10:14, 20:25] = 0
    frames[:, 15:, 12:] += 300
    for reach in (0, 2):
        for made, frame in zip(relief(frames, reach), frames, strict=True):
            assert abs(made.astype(int) - lit(frame, reach)).max() <= 1
            assert (made[frame == 0] == GREY).all() and np.ptp(made[frame > 0]) > 50
