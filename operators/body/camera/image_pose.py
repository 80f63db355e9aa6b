"""What a pose network sees of a person in the image of an ordinary camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.operators.body.camera.clothes import ALIKE, LEARN, OTHER, colours, unlike
from kinegraph.operators.body.camera.detector import SeenPerson, middle_one, people_in
from kinegraph.operators.body.names import LANDMARKS, SEEN, camera_of
from kinegraph.operators.body.network.blazepose import SIZE, Raw, look
from kinegraph.operators.body.network.crop import Image, crop, refine
from kinegraph.operators.body.network.follow import TRACKED, followed
from kinegraph.operators.body.network.operator import FIGURE, standing_figure
from kinegraph.operators.body.network.probe import probe
from kinegraph.operators.body.network.published import PERSON, POSE, Published
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

MIN_SIDE, MAX_SIDE = 0.06, 4.0
"""A square that is smaller or larger than these shares of the picture's larger side holds no person who can be followed."""
CHECK_S, GIVE_UP_S = 0.2, 5.0
"""Where the clothes are no longer those remembered, people are looked for this often; after so long the new ones are remembered."""
_reported: set[str] = set()

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class ImagePoseState:
    """
    model, detector  the networks' files; "": no network
    square           (4,)  where to look next: x, y, side, turn; NaN: look for people in the whole image
    last             stamp of the newest frame
    clothes          (6,)  colours that the person wears; NaN: not known
    doubted          since when they differ; 0: they do not; and checked, when people were looked for therefore
    """

    model: str
    detector: str
    square: Samples
    last: int
    clothes: Samples
    doubted: int
    checked: int


@dataclass(frozen=True, slots=True)
class ImagePose(Operator[ImagePoseState]):
    """The image of an ordinary camera in, what is seen of one person in it out: one sample a frame, NaN where there is no person.

    BlazePose (Apache-2.0; `kinegraph files fetch camera-models`) by LiteRT. A person is looked for in the whole image first (some 11 ms),
    and then followed from frame to frame (some 12 ms): put it on a `worker`. Of several people it takes the one who stands out near the
    middle, and stays with that person until that person is lost; where another one steps between, the person is found again
    by the colours of the clothes. No depth is measured: `points[..., 2]` is NaN, and
    operators.body.camera.one_camera.OneCamera places the landmarks by the body's height. It can be recorded where images are not.

    >>> given, made = tried(ImagePose)
    >>> given["in"].shape, made["presence"][-1].round(2).item()
    ((60, 48, 64, 3), 0.9)
    """

    inputs = {"in": Input()}
    references: ClassVar[str] = "MediaPipe Pose (networks, refinement by heat maps, next square)"
    networks: ClassVar[tuple[Published, ...]] = (POSE, PERSON)

    model: str = param(
        "", help="the landmark network's file; left out: the one that `kinegraph files fetch camera-models` brings"
    )
    detector: str = param(
        "", help="the detector's file; left out: the one that `kinegraph files fetch camera-models` brings"
    )
    needed: bool = param(True, help="false: without the networks the graph runs and finds no person")
    reset_gap_s: float = reset_gap(
        0.5, "after a longer gap the person is looked for in the whole image again", above=0.0
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != np.uint8 or len(spec.shape) not in (2, 3) or spec.shape[2:] not in ((), (1,), (3,)):
            raise InputError("in", spec.describe(), "images (height, width) or (height, width, 3) uint8")
        if min(spec.shape[:2]) < 32:
            raise InputError("in", spec.describe(), "images of at least 32 x 32 pixels")
        if camera_of(spec) is None:
            raise InputError("in", "a stream of unknown geometry", "one with `camera` in its spec: fx, fy, cx, cy")
        if self.model == FIGURE:
            model = detector = FIGURE
        else:
            model, detector = self._found(POSE, "model"), self._found(PERSON, "detector")
        channels = spec.shape[2] if len(spec.shape) == 3 else 1
        self.set_state(
            ImagePoseState(
                model if detector else "", detector, np.full(4, np.nan), 0, np.full(2 * channels, np.nan), 0, 0
            )
        )
        meta = {**spec.meta, "landmarks": list(LANDMARKS)}
        units = ("px, m", "", "")
        return {"out": StreamSpec((), SEEN, rate_hz=spec.rate_hz, units=units, settling_s=spec.settling_s, meta=meta)}

    def _found(self, network: Published, parameter: str) -> str:
        """The network's file; "" where it is missing and not needed. Raises ParameterError."""
        try:
            return str(network.path(parameter, getattr(self, parameter)))
        except ParameterError as error:
            if self.needed:
                raise
            if str(error) not in _reported:
                _reported.add(str(error))
                log.warning("no networks for an ordinary camera: it finds no person", reason=str(error))
            return ""

    def process(self, port: str, chunk: Chunk) -> Chunk:
        state, out = self.state, np.zeros(len(chunk), SEEN)
        for i, time in enumerate(chunk.time.tolist()):
            if time - state.last > self.reset_gap_s * NS:
                state.square[:] = np.nan
            state.last = time
            self._look(np.atleast_3d(chunk.data[i]), time, out[i : i + 1])
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    def _look(self, image: Image, time: int, out: Array) -> None:
        """One frame; a person who was lost is looked for in it at once."""
        points, square = out["points"][0], self.state.square
        points[:], out["presence"], out["facing"] = np.nan, np.nan, 0.0
        if not self.state.model:
            return
        followed_before = not np.isnan(square[0])
        for again in (False, True):
            if np.isnan(square[0]) and not self._find(image):
                return
            raw = self._raw(image)
            if raw.presence > TRACKED or again or not followed_before:
                break
            square[:] = np.nan
        out["presence"] = raw.presence
        if not raw.presence > TRACKED:
            square[:] = np.nan
            return
        probe(raw.points, raw.world, square, np.zeros(image.shape[:2], np.uint16), points)
        square[:] = followed(raw.points, square)
        longest, (height, width) = max(image.shape[:2]), image.shape[:2]
        inside = (
            -square[2] / 2 < square[0] < width + square[2] / 2 and -square[2] / 2 < square[1] < height + square[2] / 2
        )
        if not (inside and MIN_SIDE * longest < square[2] < MAX_SIDE * longest):
            square[:] = np.nan
        elif self.state.model != FIGURE:
            self._recognise(image, time)

    def _recognise(self, image: Image, time: int) -> None:
        """Remember what the person wears; where it is someone else's, look for the person, who is followed from the next frame on."""
        s = self.state
        now = colours(image, s.square)
        off = unlike(now, s.clothes)
        if off <= OTHER:
            s.clothes[:] = np.where(np.isnan(s.clothes), now, s.clothes + LEARN * np.nan_to_num(now - s.clothes))
            s.doubted = 0
            return
        s.doubted = s.doubted or time
        if time - s.doubted > GIVE_UP_S * NS:
            s.clothes[:], s.doubted = now, 0
        elif time - s.checked >= CHECK_S * NS:
            s.checked = time
            best = self._alike(image, people_in(image, s.detector))
            if best is not None and unlike(colours(image, best.square), s.clothes) < ALIKE * off:
                s.square[:] = best.square

    def _alike(self, image: Image, found: list[SeenPerson]) -> SeenPerson | None:
        """Of several people the one who wears what is remembered."""
        return min(found, key=lambda one: unlike(colours(image, one.square), self.state.clothes), default=None)

    def _find(self, image: Image) -> bool:
        """Look for people in the whole image, and choose one, of whom nothing is doubted yet."""
        self.state.doubted = 0
        height, width = image.shape[:2]
        if self.state.model == FIGURE:
            self.state.square[:] = width / 2, height / 2, height, 0.0
            return True
        people = people_in(image, self.state.detector)
        found = self._alike(image, people) if len(people) > 1 and not np.isnan(self.state.clothes).all() else None
        if found is None or unlike(colours(image, found.square), self.state.clothes) > OTHER:
            found = middle_one(people, width, height)
        if found:
            self.state.square[:] = found.square
        return found is not None

    def _raw(self, image: Image) -> Raw:
        part = np.empty((SIZE, SIZE, 3), np.float32)
        x, y, side, turn = self.state.square.tolist()
        crop(image, x, y, side, turn, part)
        if self.state.model == FIGURE:
            return standing_figure(part)
        raw = look(self.state.model, part)
        refine(raw.heat, raw.points)
        return raw

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(4)
        meta = {"camera": {"fx": 56.0, "fy": 56.0, "cx": 31.5, "cy": 23.5}}
        colour = StreamSpec((48, 64, 3), np.dtype(np.uint8), rate_hz=30.0, meta=meta)
        grey = StreamSpec((48, 64), np.dtype(np.uint8), rate_hz=None, meta=meta)
        images = random.integers(0, 255, (60, 48, 64, 3), np.uint8)
        return [
            Case(cls(model=FIGURE), {"in": (colour, grid(30.0, 60), images)}, least=60),
            Case(cls(model=FIGURE), {"in": (grey, grid(25.0, 60), images[..., 0].copy())}, least=60),
        ]
