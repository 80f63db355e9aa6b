"""What hands and face share: images beside what is seen of the body, a part of an image for a network, and what it finds there."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import structlog

from kinegraph.operators.body.names import SEEN
from kinegraph.operators.body.network.crop import Image, Single, crop
from kinegraph.operators.body.network.pairing import Pairing
from kinegraph.operators.body.network.published import Published
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs
from kinegraph.stream.errors import InputError, ParameterError

FIGURE = "figure"
"""The name of no network: made-up landmarks."""
Pair: TypeAlias = "tuple[int, int, Array, Array | None]"
"""Stamp, how many are lost before, what is seen, and the image of that time or None."""
Look: TypeAlias = "Callable[[int, Array, Image | None], dict[str, Array]]"
"""Looks at one frame: stamp, what is seen, image; returns one sample for each output."""
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


def pairing_of(specs: Specs) -> Pairing:
    """What brings the inputs `image` and `seen` together. Raises InputError for other streams."""
    image, seen = specs["image"], specs["seen"]
    if image.dtype != np.uint8 or image.shape[2:] not in ((), (1,), (3,)):
        raise InputError("image", image.describe(), "images (height, width) or (height, width, 3) uint8")
    if seen.dtype != SEEN:
        raise InputError("seen", seen.describe(), "what ImagePose or PoseNetwork gives")
    return Pairing.within(0.02, image, seen)


def take_pairs(pairing: Pairing, port: str, chunk: Chunk) -> list[Pair]:
    """What of the two inputs is together now."""
    return pairing.take(pairing.images if port == "image" else pairing.depths, chunk)


def looked_at(
    pairing: Pairing, pairs: list[Pair], until: int, look: Look, ports: dict[str, Array]
) -> list[tuple[str, Chunk]]:
    """What `look` makes of each pair, in a chunk of its own: what is missing before it stays at its place. `ports`: no samples of each."""
    limit, made = pairing.limit(until), list[tuple[str, Chunk]]()
    for i, (time, lost, seen, image) in enumerate(pairs):
        rows = look(time, seen, image)
        end, times = pairs[i + 1][0] - 1 if i + 1 < len(pairs) else limit, np.array([time], np.int64)
        made += [(port, Chunk(times, rows[port], end, lost)) for port in ports]
    return made or [(port, Chunk(np.empty(0, np.int64), rows, limit)) for port, rows in ports.items()]
