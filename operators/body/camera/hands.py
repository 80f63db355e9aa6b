"""The hands of a person in the image of a camera: landmarks of a hand network, and how the fingers bend."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.body.camera.hand_bends import hand_bends
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
from kinegraph.operators.body.network.published import HAND, Published, interpreter
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.domain.fingers import BENDS, MAX_BENDS, MIN_BENDS, RELAXED
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

SIZE = 224
READ = ((1, 63), (1, 1), (1, 1), (1, 63))
"""The outputs: points in the network's pixels, presence, which hand it takes it for, points in metres."""
HANDS = np.dtype([("points", "<f8", (2, 21, 3)), ("pixels", "<f8", (2, 21, 2)), ("presence", "<f8", (2,))])
"""Left and right hand: landmarks (m, from the hand's middle; x right, y down, z away from the camera), where they are in the image, and how
sure it is that a hand is there (NaN: not examined)."""
PLACES = np.array(
    [[LANDMARKS.index(f"{side}_{part}") for part in ("wrist", "index", "pinky")] for side in ("left", "right")]
)
REACH = 2.6
"""By this factor the square around a hand is larger than the way from the wrist to the middle of the knuckles."""
FOLLOWED = 1.7
"""... and by this one larger than all of its landmarks."""


@dataclass(slots=True)
class HandsState:
    """
    model    the network's file; "": no network
    pairing  images, and what is seen, that wait for their partners
    squares  (2, 4)  where to look next: x, y, side, turn; NaN: where the body's wrist is
    bends    (40,)   the newest; and seen (2,) when each hand was seen last
    last     stamp of the newest frame
    """

    model: str
    pairing: Pairing
    squares: Samples
    bends: Samples
    seen: Array
    last: int


@dataclass(frozen=True, slots=True)
class Hands(Operator[HandsState]):
    """An image, and what is seen of the body in it (ImagePose or PoseNetwork) in; the hands' landmarks and how their fingers bend out.

    out    an event a frame: landmarks of both hands in metres and pixels, NaN where a hand is not seen
    bends  (40,) degrees, channels "LeftIndex.bend" and so on (stream/domain/fingers.py), within what joints of people allow

    MediaPipe's hand network (Apache-2.0; `kinegraph files fetch camera-models`) by LiteRT, some 9 ms a hand. It looks where the body's
    wrists are, then where the hand was. A hand of less than `min_px` pixels is too small for it; one that is not seen keeps its bends for
    `hold_s` and then relaxes. On a `worker` with `drop_oldest` a slow computer loses rate here, not at the body.

    >>> given, made = tried(Hands)
    >>> made["out"]["presence"][-1].round(1).tolist(), made["bends"].shape
    ([0.9, 0.9], (40, 40))
    """

    inputs = {"image": Input(), "seen": Input()}
    outputs: ClassVar[tuple[str, ...]] = ("out", "bends")
    references: ClassVar[str] = "MediaPipe Hands (network)"
    networks: ClassVar[tuple[Published, ...]] = (HAND,)

    model: str = param(
        "", help="the network's file; left out: the one that `kinegraph files fetch camera-models` brings"
    )
    needed: bool = param(True, help="false: without the network the graph runs, and hands are relaxed")
    min_px: float = param(24.0, least=8.0, help="a hand whose square is smaller (pixels) is not examined")
    presence: float = param(0.5, least=0.0, most=1.0, help="how sure the network must be of a hand")
    hold_s: float = param(0.5, least=0.0, help="for how long an unseen hand keeps its bends")
    relax_s: float = param(0.5, above=0.0, help="how quickly it relaxes then")

    def open(self, specs: Specs) -> Specs:
        pairing, seen = pairing_of(specs), specs["seen"]
        model = model_of(HAND, self.model, needed=self.needed)
        self.set_state(HandsState(model, pairing, np.full((2, 4), np.nan), RELAXED.copy(), np.zeros(2, np.int64), 0))
        rate, settling = seen.rate_hz, seen.settling_s
        return {
            "out": StreamSpec((), HANDS, rate, units=("m", "px", ""), settling_s=settling, meta=seen.meta),
            "bends": StreamSpec((len(BENDS),), rate_hz=rate, channels=BENDS, units=("deg",), settling_s=settling),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        return self._made(take_pairs(self.state.pairing, port, chunk), chunk.until)

    def close(self) -> list[tuple[str, Chunk]]:
        return self._made(self.state.pairing.pairs(FOREVER), FOREVER)

    def _made(self, pairs: list[Pair], until: int) -> list[tuple[str, Chunk]]:
        ports = {"out": np.zeros(0, HANDS), "bends": np.zeros((0, len(BENDS)))}
        return looked_at(self.state.pairing, pairs, until, self._look, ports)

    def _look(self, time: int, seen: Array, image: Image | None) -> dict[str, Array]:
        """One frame, both hands."""
        state, made = self.state, np.zeros(1, HANDS)
        out = made[0]
        out["points"], out["pixels"], out["presence"] = np.nan, np.nan, np.nan
        since = (time - state.last) / NS if state.last else 0.0
        state.last = time
        for hand in range(2):
            rows = slice(20 * hand, 20 * hand + 20)
            if image is not None and state.model and self._hand(hand, seen, np.atleast_3d(image), out):
                bends = np.empty((5, 4))
                hand_bends(np.ascontiguousarray(out["points"][hand]), hand == 0, bends)
                state.bends[rows] = np.clip(bends.ravel(), MIN_BENDS[rows], MAX_BENDS[rows])
                state.seen[hand] = time
            elif time - state.seen[hand] > self.hold_s * NS:
                share = 1.0 - math.exp(-since / self.relax_s)
                state.bends[rows] += share * (RELAXED[rows] - state.bends[rows])
        return {"out": made, "bends": state.bends[None].copy()}

    def _hand(self, hand: int, seen: Array, image: Image, out: Array) -> bool:
        """Whether this hand is seen; its landmarks into `out`."""
        square = self.state.squares[hand]
        at_wrist = self._square(hand, seen)
        if np.isnan(square[0]) or (at_wrist is not None and math.dist(square[:2], at_wrist[:2]) > at_wrist[2]):
            square[:] = np.nan if at_wrist is None else at_wrist
        if np.isnan(square[0]) or square[2] < self.min_px:
            square[:] = np.nan
            return False
        x, y, side, turn = square.tolist()
        around = Around(x, y, side, turn, SIZE)
        points, presence, world = self._raw(part_of(image, around))
        out["presence"][hand] = presence
        if not presence >= self.presence:
            square[:] = np.nan
            return False
        pixels = around.in_image(points[:, :2])
        out["pixels"][hand], out["points"][hand] = pixels, around.turned(world)
        square[:] = _around(pixels)
        return True

    def _square(self, hand: int, seen: Array) -> Samples | None:
        """Where the body's wrist and knuckles say that the hand is; None where they are not seen."""
        wrist, index, pinky = seen["points"][PLACES[hand]]
        if not min(wrist[3], index[3], pinky[3]) > 0.3:
            return None
        middle = (2.0 * index[:2] + pinky[:2]) / 3.0
        across, down = middle - wrist[:2]
        side = REACH * 2.0 * math.hypot(across, down)
        turn = math.pi / 2 - math.atan2(-down, across)
        return np.array([middle[0] + 0.1 * across, middle[1] + 0.1 * down, side, turn])

    def _raw(self, part: Single) -> tuple[Samples, float, Samples]:
        """Landmarks (21, 3) in the part's pixels, presence, landmarks (21, 3) in metres."""
        if self.state.model == FIGURE:
            return _flat_hand(float(part.mean()))
        network, given, outputs = interpreter(self.state.model, READ, HAND.what, "model")
        network.set_tensor(given, part[None])
        network.invoke()
        points, presence, _, world = (network.get_tensor(index)[0] for index in outputs)
        return points.reshape(21, 3).astype(float), float(presence[0]), world.reshape(21, 3).astype(float)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random, n = np.random.default_rng(5), 40
        images, seen = random.integers(0, 255, (n, 48, 64, 3), np.uint8), np.zeros(n, SEEN)
        k = np.arange(34)
        seen["points"][..., 0], seen["points"][..., 1] = 20 + k % 2 * 12 + k * 0.3, 12 + k
        seen["points"][..., 3:5], seen["presence"] = 0.9, 0.9
        seen["points"][20:26, :, 3] = 0.1
        image = StreamSpec((48, 64, 3), np.dtype(np.uint8), rate_hz=30.0)
        spec = StreamSpec((), SEEN, rate_hz=30.0, units=("px, m", "", ""))
        given = {"image": (image, grid(30.0, n), images), "seen": (spec, grid(30.0, n), seen)}
        return [
            Case(cls(model=FIGURE, min_px=8.0), given, least=38),
            Case(cls(model=FIGURE, min_px=400.0), given, least=38),
        ]


def _around(pixels: Samples) -> Samples:
    """The next square around landmarks (21, 2): upright from the wrist to the middle of the knuckles."""
    across, down = (2.0 * pixels[5] + 2.0 * pixels[9] + pixels[17]) / 5.0 - pixels[0]
    turn = math.pi / 2 - math.atan2(-down, across)
    c, s = math.cos(turn), math.sin(turn)
    upright = pixels @ np.array([[c, -s], [s, c]])
    low, high = upright.min(axis=0), upright.max(axis=0)
    x, y = np.array([[c, -s], [s, c]]) @ ((low + high) / 2.0)
    return np.array([x, y, FOLLOWED * max(high - low), turn])


def _flat_hand(light: float) -> tuple[Samples, float, Samples]:
    """No network: a flat hand whose fingers bend with the light."""
    world = np.zeros((21, 3))
    for finger in range(5):
        for joint in range(4):
            long = 0.03 + 0.03 * joint
            world[1 + 4 * finger + joint] = 0.02 * (finger - 2), -0.05 - long * math.cos(light), long * math.sin(light)
    return np.c_[112.0 + 900.0 * world[:, :1], 170.0 + 900.0 * world[:, 1:2], world[:, 2:]], 0.9, world
