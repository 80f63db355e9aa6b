"""What a pose network sees of a person, in an image beside the person's depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.operators.body.facing import CELLS, facing_of, shape_of, weights
from kinegraph.operators.body.names import LANDMARKS, SEEN, camera_of
from kinegraph.operators.body.network.blazepose import POINTS, SIZE, Raw, look, model_path
from kinegraph.operators.body.network.crop import Image, crop, refine
from kinegraph.operators.body.network.follow import AROUND, TRACKED, followed
from kinegraph.operators.body.network.pairing import Pairing
from kinegraph.operators.body.network.probe import box_of, probe
from kinegraph.operators.body.network.published import POSE, Published
from kinegraph.operators.body.network.sync_check import InStep
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Samples, Specs, StreamSpec, empty
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

LEAST_PIXELS = 150
FIGURE = "figure"
"""The name of no network: a standing figure in the person's box."""
_reported: set[str] = set()

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class PoseNetworkState:
    """
    model     the network's file; "": no network
    pairing   frames that wait for their partner
    in_step   whether images are of the time that their stamps say
    square    (4,)  where to look next: x, y, side, turn; NaN: in the person's box
    last      stamp of the newest frame
    """

    model: str
    pairing: Pairing
    in_step: InStep
    square: Samples
    last: int


@dataclass(frozen=True, slots=True)
class PoseNetwork(Operator[PoseNetworkState]):
    """An image and the depth of one person in it (0 elsewhere, of operators.body.persons.Persons) in, what is seen of that person out.

    BlazePose full (Apache-2.0; `kinegraph files fetch pose-model`) by LiteRT, on colour, grey or infrared, some 10 ms a frame: put it on a
    `worker`. It looks where the depth says that the person is, so no frame is spent on finding people. One sample comes out for every
    frame of depth, NaN without a person in view or an image within `apart_s`. It can be recorded where images are not, and
    everything after it computed from it again. Images that show another moment than their stamps say, by 50 ms or more, are found out by
    the outline that moves in them and in the depth, within seconds; they are left alone, and the log says so. It is not what the network
    says alone: the depth at every landmark and where the body's shape faces are in it. With `needed: false` a graph runs where the network
    or its runtime is missing, too: every sample is then NaN, and the log reports once what to install.

    >>> given, made = tried(PoseNetwork)
    >>> given["image"].shape, made["presence"][-1].round(2).item()
    ((60, 32, 24), 0.9)
    """

    inputs = {"image": Input(), "person": Input()}
    references: ClassVar[str] = "MediaPipe Pose (network, refinement by heat maps, next square)"
    networks: ClassVar[tuple[Published, ...]] = (POSE,)

    model: str = param("", help="the network's file; left out: the one that `kinegraph files fetch pose-model` brings")
    needed: bool = param(True, help="false: without the network the graph runs and finds no person")
    apart_s: float = param(0.02, above=0.0, most=1.0, help="an image and a depth frame further apart are no pair")
    reset_gap_s: float = reset_gap(
        0.5, "after a longer gap the person is looked for in the box of the depth again", above=0.0
    )

    def open(self, specs: Specs) -> Specs:
        image, person = specs["image"], specs["person"]
        if person.dtype != np.uint16 or len(person.shape) != 2 or person.shape[0] * person.shape[1] < 64:
            raise InputError("person", person.describe(), "depth (height, width) uint16 in mm, 0 but for one person")
        if image.dtype != np.uint8 or image.shape[:2] != person.shape or image.shape[2:] not in ((), (1,), (3,)):
            height, width = person.shape
            raise InputError(
                "image", image.describe(), f"{height} x {width} uint8, or {height} x {width} x 3: aligned to the depth"
            )
        if camera_of(person) is None:
            raise InputError("person", "a stream of unknown geometry", "one with `camera` in its spec: fx, fy, cx, cy")
        model = FIGURE if self.model == FIGURE else self._found()
        pairing = Pairing.within(self.apart_s, image, person)
        self.set_state(PoseNetworkState(model, pairing, InStep.for_frames(person), np.full(4, np.nan), 0))
        meta = {**person.meta, "landmarks": list(LANDMARKS)}
        settling_s = max(image.settling_s, person.settling_s)
        spec = StreamSpec((), SEEN, rate_hz=person.rate_hz, units=("px, m", "", ""), settling_s=settling_s, meta=meta)
        return {"out": spec}

    def _found(self) -> str:
        """The network's file; "" where it is missing and not needed. Raises ParameterError."""
        try:
            return str(model_path(self.model))
        except ParameterError as error:
            if self.needed:
                raise
            if str(error) not in _reported:
                _reported.add(str(error))
                log.warning("no pose network: it finds no person", reason=str(error))
            return ""

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        pairing = self.state.pairing
        return self._made(pairing.take(pairing.images if port == "image" else pairing.depths, chunk), chunk.until)

    def close(self) -> list[tuple[str, Chunk]]:
        return self._made(self.state.pairing.pairs(FOREVER), FOREVER)

    def _made(self, pairs: list[tuple[int, int, Array, Array | None]], until: int) -> list[tuple[str, Chunk]]:
        """A sample for each pair; a chunk more where samples are missing before one."""
        out, times = np.zeros(len(pairs), SEEN), np.array([pair[0] for pair in pairs], np.int64)
        for i, (time, _, depth, image) in enumerate(pairs):
            if time - self.state.last > self.reset_gap_s * NS:
                self.state.square[:] = np.nan
            self.state.last = time
            if image is not None and not self.state.in_step.watch(time, depth, image):
                image = None
            self._look(depth, image, out[i : i + 1])
        limit = self.state.pairing.limit(until)
        lost = np.array([pair[1] for pair in pairs], np.int64)
        if not len(lost):
            return [("out", empty(StreamSpec((), SEEN), limit))]
        untils = [*(times[1:] - 1).tolist(), limit]
        return [
            ("out", Chunk(times[a:b], out[a:b], untils[b - 1], int(lost[a])))
            for a, b in pairwise([0, *(1 + np.flatnonzero(lost[1:])).tolist(), len(lost)])
        ]

    def _look(self, depth: Array, image: Image | None, out: Array) -> None:
        """One frame."""
        points, square, shape = out["points"][0], self.state.square, np.empty((2, CELLS, CELLS))
        points[:], out["presence"], out["facing"] = np.nan, np.nan, 0.0
        if shape_of(depth, shape) < LEAST_PIXELS:
            square[:] = np.nan
            return
        facing_of(shape, *weights(), out["facing"][0])
        if image is None or not self.state.model:
            return
        box = np.empty(4)
        box_of(depth, box)
        if np.isnan(square[0]):
            square[:] = box[0], box[1], AROUND * max(box[2], box[3]), 0.0
        raw = self._raw(image, square)
        out["presence"] = raw.presence
        probe(raw.points, raw.world, square, depth, points)
        self._next_square(raw, box)

    def _raw(self, image: Image, square: Samples) -> Raw:
        part = np.empty((SIZE, SIZE, 3), np.float32)
        x, y, side, turn = square.tolist()
        crop(np.atleast_3d(image), x, y, side, turn, part)
        if self.model == FIGURE:
            return standing_figure(part)
        raw = look(self.state.model, part)
        refine(raw.heat, raw.points)
        return raw

    def _next_square(self, raw: Raw, box: Samples) -> None:
        """Around the middle of the hips (point 33), turned so that the trunk (to point 34) is upright."""
        square = self.state.square
        if not raw.presence > TRACKED:
            square[:] = np.nan
            return
        x, y, side, turn = followed(raw.points, square)
        longest = AROUND * max(box[2], box[3])
        square[:] = x, y, min(max(side, 0.8 * longest), 1.5 * longest), turn

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(4)
        times, depth = grid(30.0, 60), np.zeros((60, 32, 24), np.uint16)
        depth[:, 4:30, 8:15] = random.integers(2400, 2600, (60, 26, 7))
        depth[20:24] = 0
        images = random.integers(0, 255, (60, 32, 24), np.uint8)
        camera = {"camera": {"fx": 30.0, "fy": 30.0, "cx": 11.5, "cy": 15.5}}
        person = (StreamSpec((32, 24), np.dtype(np.uint16), rate_hz=30.0, units=("mm",), meta=camera), times, depth)
        grey = (StreamSpec((32, 24), np.dtype(np.uint8), rate_hz=30.0), times, images)
        late = (grey[0], times + 7_000_000, images)
        colour = (
            StreamSpec((32, 24, 3), np.dtype(np.uint8), rate_hz=15.0),
            times[::2],
            np.repeat(images[::2, ..., None], 3, 3),
        )
        kinds = {"grey": grey, "late": late, "colour": colour}
        return [Case(cls(model=FIGURE), {"image": image, "person": person}, least=55) for image in kinds.values()]


def standing_figure(part: Array) -> Raw:
    """No network: a standing figure, as large as the square, that leans with the light in the image."""
    points, world = np.zeros((POINTS, 5)), np.zeros((POINTS, 3))
    k = np.arange(POINTS)
    lean = float(part[::16, ::16, 0].mean()) - 0.5
    points[:, 0] = SIZE * (0.5 + np.where(k % 2, 0.1, -0.1) + 0.1 * lean)
    points[:, 1] = SIZE * (0.1 + 0.8 * np.minimum(k, 32) / 32)
    points[33, :2], points[34, :2] = (128.0, 140.0), (128.0 + 10.0 * lean, 25.0)
    points[:, 3:] = 3.0
    world[:, 0], world[:, 1] = np.where(k % 2, 0.2, -0.2), 1.7 * (points[:, 1] / SIZE - 0.5)
    return Raw(points, 0.9, np.zeros((64, 64, POINTS), np.float32), world)
