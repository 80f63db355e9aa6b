"""The face of a person in the image of a camera: what it does, as weights of an avatar's expressions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.body.camera.expressions import EXPRESSIONS, MEASURES, expressions, learn_rest, measures
from kinegraph.operators.body.camera.parts import (
    FIGURE,
    Around,
    Pair,
    looked_at,
    model_of,
    pairing_of,
    part_of,
    take_pairs,
)
from kinegraph.operators.body.names import LANDMARKS, SEEN
from kinegraph.operators.body.network.crop import Image, Single
from kinegraph.operators.body.network.pairing import Pairing
from kinegraph.operators.body.network.published import FACE, Published, interpreter
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

SIZE, POINTS = 192, 468
READ = ((1, 1, 1, 3 * POINTS), (1, 1, 1, 1))
"""The outputs: points in the network's pixels, and how sure it is of a face (a logit)."""
EYES = [LANDMARKS.index(f"{side}_eye_{end}") for side in ("right", "left") for end in ("outer", "inner")]
MOUTH = [LANDMARKS.index(name) for name in ("mouth_right", "mouth_left")]
REACH, FOLLOWED = 4.2, 1.5
"""By this factor the square is larger than the way from the eyes to the mouth; and than all of the face's points."""
CORNERS = (33, 263)
"""Outer corners of the right and the left eye."""


@dataclass(slots=True)
class FaceState:
    """
    model    the network's file; "": no network
    pairing  images, and what is seen, that wait for their partners
    square   (4,)  where to look next: x, y, side, turn; NaN: where the body's eyes and mouth are
    rest     (11,) the measures of this face at rest, and count (1,) of how many frames
    weights  (21,) the newest
    seen     when the face was seen last; last: stamp of the newest frame
    """

    model: str
    pairing: Pairing
    square: Samples
    rest: Samples
    count: Samples
    weights: Samples
    seen: int
    last: int


@dataclass(frozen=True, slots=True)
class Face(Operator[FaceState]):
    """An image, and what is seen of the body in it (ImagePose or PoseNetwork) in; weights (0 to 1) of 21 expressions out, for an avatar.

    Channels: Blink_L and Blink_R, the vowels A, I, U, E, O (as VRM 0 and VMC call them), and the coefficients of ARKit that follow from the
    face's surface: jawOpen, mouthFunnel, mouthPucker, mouthSmile, mouthStretch, browInnerUp, browOuterUp, browDown. Left is the person's
    own.

    MediaPipe's face mesh (Apache-2.0; `kinegraph files fetch camera-models`) by LiteRT, some 2 ms. Weights are by how far the face is from
    its own rest, which is learned over `learn_s`: look at the camera with a calm face first. Where the eyes look is not found: the network
    that follows irises is in no package that may be fetched. A face that is turned away or smaller than `min_px` relaxes after `hold_s`.

    >>> given, made = tried(Face)
    >>> made.shape, (made >= 0.0).all().item(), (made <= 1.0).all().item()
    ((40, 21), True, True)
    """

    inputs = {"image": Input(), "seen": Input()}
    references: ClassVar[str] = "MediaPipe Face Mesh (network); eye aspect ratio: Soukupova and Cech 2016"
    networks: ClassVar[tuple[Published, ...]] = (FACE,)

    model: str = param(
        "", help="the network's file; left out: the one that `kinegraph files fetch camera-models` brings"
    )
    needed: bool = param(True, help="false: without the network the graph runs, and the face rests")
    min_px: float = param(32.0, least=8.0, help="a face whose square is smaller (pixels) is not examined")
    learn_s: float = param(20.0, above=0.0, help="over how long a face's rest is learned")
    hold_s: float = param(0.5, least=0.0, help="for how long an unseen face keeps its weights")
    relax_s: float = param(0.3, above=0.0, help="how quickly it relaxes then")

    def open(self, specs: Specs) -> Specs:
        pairing, seen = pairing_of(specs), specs["seen"]
        model = model_of(FACE, self.model, needed=self.needed)
        rest, weights = np.full(MEASURES, np.nan), np.zeros(len(EXPRESSIONS))
        self.set_state(FaceState(model, pairing, np.full(4, np.nan), rest, np.zeros(1), weights, 0, 0))
        shape, rate = (len(EXPRESSIONS),), seen.rate_hz
        return {"out": StreamSpec(shape, rate_hz=rate, channels=EXPRESSIONS, settling_s=seen.settling_s)}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        return self._made(take_pairs(self.state.pairing, port, chunk), chunk.until)

    def close(self) -> list[tuple[str, Chunk]]:
        return self._made(self.state.pairing.pairs(FOREVER), FOREVER)

    def _made(self, pairs: list[Pair], until: int) -> list[tuple[str, Chunk]]:
        return looked_at(self.state.pairing, pairs, until, self._look, {"out": np.zeros((0, len(EXPRESSIONS)))})

    def _look(self, time: int, seen: Array, image: Image | None) -> dict[str, Array]:
        self._follow(time, seen, image)
        return {"out": self.state.weights[None].copy()}

    def _follow(self, time: int, seen: Array, image: Image | None) -> None:
        """One frame."""
        state = self.state
        since = (time - state.last) / NS if state.last else 0.0
        state.last = time
        points = self._face(seen, np.atleast_3d(image)) if image is not None and state.model else None
        if points is None:
            if time - state.seen > self.hold_s * NS:
                state.weights *= math.exp(-since / self.relax_s)
            return
        now = np.empty(MEASURES)
        measures(points, now)
        learn_rest(now, 1.0 - math.exp(-since / self.learn_s), float(state.count[0]), state.rest)
        state.count[0] += 1.0
        expressions(now, state.rest, state.weights)
        state.seen = time

    def _face(self, seen: Array, image: Image) -> Samples | None:
        """The face's points (468, 3) in pixels, or None."""
        square, beside = self.state.square, self._square(seen)
        if np.isnan(square[0]) or (beside is not None and math.dist(square[:2], beside[:2]) > beside[2] / 2):
            square[:] = np.nan if beside is None else beside
        if np.isnan(square[0]) or square[2] < self.min_px:
            square[:] = np.nan
            return None
        x, y, side, turn = square.tolist()
        around = Around(x, y, side, turn, SIZE)
        raw, presence = self._raw(part_of(image, around))
        if not presence > 0.5:
            square[:] = np.nan
            return None
        points: Samples = np.hstack([around.in_image(raw[:, :2]), raw[:, 2:] * (around.side / SIZE)])
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        across, down = points[CORNERS[1], :2] - points[CORNERS[0], :2]
        square[:] = *((low + high) / 2), FOLLOWED * max(high - low), math.atan2(down, across)
        return points

    def _square(self, seen: Array) -> Samples | None:
        """Where the body's eyes and mouth say that the face is; None where they are not seen."""
        points = seen["points"]
        if not min(points[EYES, 3].min(), points[MOUTH, 3].min()) > 0.5:
            return None
        eyes, mouth = points[EYES, :2].mean(axis=0), points[MOUTH, :2].mean(axis=0)
        across, down = points[EYES[2], :2] - points[EYES[0], :2]
        return np.array([*((eyes + mouth) / 2), REACH * math.dist(eyes, mouth), math.atan2(down, across)])

    def _raw(self, part: Single) -> tuple[Samples, float]:
        """Points (468, 3) in the part's pixels, and how sure the network is (0 to 1)."""
        if self.state.model == FIGURE:
            return _oval(float(part.mean())), 0.9
        network, given, outputs = interpreter(self.state.model, READ, FACE.what, "model")
        network.set_tensor(given, part[None])
        network.invoke()
        points, logit = (network.get_tensor(index).ravel() for index in outputs)
        return points.reshape(POINTS, 3).astype(float), 1.0 / (1.0 + math.exp(-min(max(float(logit[0]), -50.0), 50.0)))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random, n = np.random.default_rng(5), 40
        images, seen = random.integers(0, 255, (n, 48, 64, 3), np.uint8), np.zeros(n, SEEN)
        images[10:14] //= 3
        k = np.arange(34)
        seen["points"][..., 0], seen["points"][..., 1] = 30 - np.where(k % 2, 3, -3), 15 + k * 0.5
        seen["points"][..., 3:5], seen["presence"] = 0.9, 0.9
        seen["points"][20:26, :, 3] = 0.1
        image = StreamSpec((48, 64, 3), np.dtype(np.uint8), rate_hz=30.0)
        spec = StreamSpec((), SEEN, rate_hz=30.0, units=("px, m", "", ""))
        given = {"image": (image, grid(30.0, n), images), "seen": (spec, grid(30.0, n), seen)}
        return [
            Case(cls(model=FIGURE, min_px=8.0), given, least=38),
            Case(cls(model=FIGURE, min_px=400.0), given, least=38),
        ]


def _oval(light: float) -> Samples:
    """No network: points on an oval that is as tall as the light is bright."""
    k = np.arange(POINTS)
    angle = 2.399963 * k
    far = np.sqrt(k / POINTS)
    across, down = 96 + 50 * far * np.cos(angle), 96 + 60 * far * np.sin(angle) * (0.8 + 0.4 * light)
    return np.stack([across, down, 10 * np.cos(angle)], axis=1)
