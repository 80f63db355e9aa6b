"""A part of an image for a network, and what it finds there back in the image: shared by hands and face."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import structlog

from kinegraph.operators.body.network.crop import Image, Single, crop
from kinegraph.operators.body.network.pairing import Pairing
from kinegraph.operators.body.network.published import Published
from kinegraph.stream.chunk import Array, Chunk, Samples
from kinegraph.stream.errors import ParameterError

FIGURE = "figure"
"""The name of no network: made-up landmarks."""
_reported: set[str] = set()

log = structlog.get_logger(__name__)


class Around(NamedTuple):
    """A square of an image: middle, side (pixels) and turn (rad); `size` pixels a side for the network."""

    x: float
    y: float
    side: float
    turn: float
    size: int

    def in_image(self, points: Samples) -> Samples:
        """Points (n, 2) in the network's pixels as pixels of the image."""
        return (points - self.size / 2) @ self._rotation().T * (self.side / self.size) + (self.x, self.y)

    def turned(self, world: Samples) -> Samples:
        """Points (n, 3) in the axes of the square as in those of the image."""
        made = world.copy()
        made[:, :2] = world[:, :2] @ self._rotation().T
        return made

    def _rotation(self) -> Samples:
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([[c, -s], [s, c]])


def part_of(image: Image, around: Around) -> Single:
    """That square of an image (h, w, c), for the network."""
    part = np.empty((around.size, around.size, 3), np.float32)
    crop(image, around.x, around.y, around.side, around.turn, part)
    return part


def model_of(network: Published, given: str, *, needed: bool) -> str:
    """The network's file; "" where it is missing and not needed. Raises ParameterError."""
    if given == FIGURE:
        return FIGURE
    try:
        return str(network.path("model", given))
    except ParameterError as error:
        if needed:
            raise
        if str(error) not in _reported:
            _reported.add(str(error))
            log.warning("a network is missing: nothing is found by it", network=network.what, reason=str(error))
        return ""


def take_pairs(pairing: Pairing, port: str, chunk: Chunk) -> list[tuple[int, int, Array, Array | None]]:
    """What of the two inputs `image` and `seen` is together now: (stamp, lost, seen, image or None)."""
    return pairing.take(pairing.images if port == "image" else pairing.depths, chunk)
