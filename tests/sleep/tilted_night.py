"""What the bed's operators make of a tilted camera's frames, straight from blocks; left-out rooms have seeds of 1000 and more."""

from __future__ import annotations

import numpy as np

from kinegraph.operators.bed.frames.blocks import simplify
from kinegraph.operators.bed.frames.regions import REGION, region_spec
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import BLOCK, META, blocks_spec
from tests.sleep.tilted_room import TiltedRoom

WIDTH, HEIGHT, START = 256, 192, 900 * NS


def blocks_of(room: TiltedRoom, seconds: float, fps: float) -> Array:
    """Mean depths of blocks (frames, rows, columns)."""
    height, width = room.empty.shape
    tiles, centre = np.full((1, BLOCK, width), 1 / BLOCK, np.float32), np.zeros((BLOCK, width), np.float32)
    shift, out = np.array([[float(BLOCK), 0.0]], np.float32), np.empty((height, width), np.uint16)
    made = np.empty((round(seconds * fps), height // BLOCK, width // BLOCK))
    for k, means in enumerate(made):
        simplify(room.frame(k / fps), tiles, centre, shift, BLOCK * BLOCK // 2, out, means)
    return made


def inputs(room: TiltedRoom, seconds: float, fps: float) -> dict[str, tuple[StreamSpec, Array, Array]]:
    """Blocks, and the bed's rectangle as a person would set it."""
    depth = blocks_of(room, seconds, fps)
    time = grid(fps, len(depth), START)
    rectangle = np.array([(START, "a", *room.rectangle(), False)], REGION)
    return {
        "regions": (region_spec(("a",), META), rectangle["onset"].copy(), rectangle),
        "blocks": (blocks_spec(*depth.shape[1:], fps), time, depth),
    }
