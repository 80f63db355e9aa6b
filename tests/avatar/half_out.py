"""Scenes in which the image's border cuts the rendered performer, and which joints are outside by the truth."""

from __future__ import annotations

from typing import NamedTuple
from unittest import mock

import numpy as np

from kinegraph.devices.people import rendered_performer
from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer, camera_of
from kinegraph.stream.chunk import Array
from tests.avatar.test_degraded_scenes import empty_room

FIRST, LAST = 135, 180
"""The frames with the trouble, of 30 a second."""
MARGIN_M = 0.05
"""A joint this far outside is not seen at all; nearer to the border a part of the limb around it still is."""


class HalfOut(NamedTuple):
    """The person is `aside`, in widths of the image, and `away_m` from the camera: at once, or after so many `frames`."""

    aside: float = 0.0
    away_m: float = rendered_performer.AWAY_M
    frames: int = 1

    def _at(self, k: int, width: int) -> tuple[int, float]:
        share, usual = min(1.0, (k - FIRST + 1) / self.frames), rendered_performer.AWAY_M
        return round(share * self.aside * width), usual + share * (self.away_m - usual)

    def __call__(self, k: int, depth: Array, image: Array) -> tuple[Array, Array]:
        h, w = depth.shape
        shift, away = self._at(k, w)
        if away != rendered_performer.AWAY_M:
            with mock.patch.object(rendered_performer, "AWAY_M", away):
                performer = RenderedPerformer(w, h)
                depth, image = performer.frame(k, k / 30.0), performer.image(k, k / 30.0)
        bare, dark = empty_room(k, depth)
        to, of = slice(max(shift, 0), w + min(shift, 0)), slice(max(-shift, 0), w - max(shift, 0))
        bare[:, to], dark[:, to] = depth[:, of], image[:, of]
        return bare, dark

    def outside(self, width: int, height: int) -> Array:
        """Which of POINTS (LAST - FIRST, 13) are outside the image by MARGIN_M."""
        made = np.zeros((LAST - FIRST, len(POINTS)), np.bool_)
        fx, fy, cx, cy = camera_of(width, height)
        performer = RenderedPerformer(width, height)
        for k in range(FIRST, LAST):
            shift, away = self._at(k, width)
            with mock.patch.object(rendered_performer, "AWAY_M", away):
                x, y, z = performer.joints(k / 30.0).T
            u, v, near = cx + fx * x / z + shift, cy + fy * y / z, MARGIN_M * fx / z
            made[k - FIRST] = (u < -near) | (u > width - 1 + near) | (v < -near) | (v > height - 1 + near)
        return made
