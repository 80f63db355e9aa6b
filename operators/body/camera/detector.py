"""Where people are in an image: BlazePose's detector, for the first frame and whenever no person is followed."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from kinegraph.operators.body.network.crop import Image, Single, crop
from kinegraph.operators.body.network.published import PERSON, interpreter
from kinegraph.stream.chunk import Samples

SIZE = 224
READ = ((1, 2254, 12), (1, 2254, 1))
"""The outputs: a box and four points for each anchor, and how sure it is (a logit)."""
GRIDS = ((28, 2), (14, 2), (7, 6))
"""Anchors: this many a side, and how many at each place."""
SURE = 0.5
SAME = 0.5
"""Two finds with hips nearer than this share of the larger one's size are one person."""
AROUND = 1.25
"""How much larger than twice the way from the hips to the end of the body the square is."""


class SeenPerson(NamedTuple):
    """A person: how sure; and the square in the image around hips that is upright for the person: x, y, side (pixels), turn (rad)."""

    sure: float
    square: Samples


@cache
def _anchors() -> Samples:
    """(2254, 2): x and y as shares of the picture."""
    rows = []
    for side, count in GRIDS:
        places = (np.arange(side) + 0.5) / side
        x, y = np.meshgrid(places, places)
        rows.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=1), count, axis=0))
    return np.concatenate(rows)


def people_in(image: Image, path: str) -> list[SeenPerson]:
    """The people in `image` (h, w, 3) uint8, the surest first."""
    height, width = image.shape[:2]
    side = float(max(height, width))
    part = np.empty((SIZE, SIZE, 3), np.float32)
    crop(image, width / 2, height / 2, side, 0.0, part)
    boxes, scores = _outputs(part, path)
    sure = np.flatnonzero(scores > SURE)
    found: list[SeenPerson] = []
    for k in sure[np.argsort(-scores[sure], kind="stable")].tolist():
        points = boxes[k, 4:8].reshape(2, 2).astype(float) / SIZE + _anchors()[k]
        hips, end = (points - 0.5) * side + (width / 2, height / 2)
        reach = math.hypot(*(end - hips))
        turn = math.pi / 2 - math.atan2(hips[1] - end[1], end[0] - hips[0])
        square = np.array([hips[0], hips[1], 2 * AROUND * reach, turn])
        if all(math.hypot(*(square[:2] - other.square[:2])) > SAME * reach for other in found):
            found.append(SeenPerson(float(scores[k]), square))
    return found


def _outputs(part: Single, path: str) -> tuple[Samples, Samples]:
    network, given, outputs = interpreter(path, READ, PERSON.what, "detector")
    network.set_tensor(given, (part * 2.0 - 1.0)[None])
    network.invoke()
    boxes, logits = (network.get_tensor(index)[0] for index in outputs)
    return boxes, 1.0 / (1.0 + np.exp(-np.clip(logits[:, 0].astype(float), -50.0, 50.0)))


def middle_one(found: list[SeenPerson], width: int, height: int) -> SeenPerson | None:
    """Of several people the one who stands out: large, and near the middle from side to side."""
    if not found:
        return None

    def out(one: SeenPerson) -> float:
        x, side = float(one.square[0]), float(one.square[2])
        return side / height * (1.0 - 0.8 * min(abs(x - width / 2) / (width / 2), 1.0))

    return max(found, key=out)
