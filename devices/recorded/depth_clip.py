"""A short clip of depth and infrared frames in one .npz file, played as a camera: for tests and benches."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

NEEDED = ("depth", "background", "ir_jpeg", "ir_offsets", "K", "fps")


@dataclass(frozen=True, slots=True)
class DepthClip(Source):
    """Frames from a .npz file, at their own rate.

    depth  (height, width) uint16 in mm, 0: no measurement
    ir     (height, width) uint8, as an infrared camera under flood light sees it; the same stamps, the same pixels

    The file holds `depth` (n, h, w), `background` (h, w; the scene without the person), `ir_jpeg` and `ir_offsets` (frame i is the JPEG
    from byte ir_offsets[i] on), `K` (fx, fy, cx, cy) and `fps`. The empty scene is shown for `empty_s` before the clip.
    """

    outputs: ClassVar[tuple[str, ...]] = ("depth", "ir")

    path: str = param(help="the file, CLIP.npz")
    empty_s: float = param(2.0, least=0.0, help="how long the scene is shown without the person before")
    realtime: bool = param(True, help="false: as fast as the graph takes it")

    @property
    def live(self) -> bool:
        return self.realtime

    @property
    def chunk_s(self) -> float:
        return 1 / float(self._clip()["fps"])

    def specs(self) -> Specs:
        clip = self._clip()
        fx, fy, cx, cy = (float(v) for v in clip["K"])
        meta = {
            "device": "clip",
            "invalid": 0,
            "camera": {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": [0.0] * 5},
        }
        shape, rate = clip["background"].shape, float(clip["fps"])
        return {
            "depth": StreamSpec(shape, np.dtype(np.uint16), rate_hz=rate, units=("mm",), meta=meta),
            "ir": StreamSpec(shape, np.dtype(np.uint8), rate_hz=rate, meta={**meta, "light": "flood"}),
        }

    def read(self, feed: Feed) -> None:
        clip, begun = self._clip(), feed.now()
        period = NS / float(clip["fps"])
        for k, (depth, image) in enumerate(self._frames(clip)):
            stamp = begun + round((k + 1) * period)
            if self.realtime and feed.wait(max(0, stamp - feed.now()) / NS):
                return
            if feed.stopped:
                return
            time = np.array([stamp])
            feed.emit(Chunk(time, depth[None], stamp), "depth")
            feed.emit(Chunk(time, image[None], stamp), "ir")

    def _frames(self, clip: dict[str, Array]) -> Iterator[tuple[Array, Array]]:
        """Depth and image of the empty scene, then of the clip."""
        random = np.random.default_rng(0)
        for _ in range(round(self.empty_s * float(clip["fps"]))):
            image = random.normal(18, 4, clip["background"].shape).clip(0, 255).astype(np.uint8)
            yield clip["background"], image
        for i, depth in enumerate(clip["depth"]):
            yield depth, _decoded(clip["ir_jpeg"][clip["ir_offsets"][i] : clip["ir_offsets"][i + 1]].tobytes())

    def _clip(self) -> dict[str, Array]:
        """The file's arrays. Raises ParameterError."""
        try:
            with np.load(Path(self.path), allow_pickle=False) as file:
                return {name: file[name] for name in NEEDED}
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
            accepts = f"a .npz file with {', '.join(NEEDED)} ({error})"
            raise ParameterError("path", self.path, accepts) from None


def _decoded(data: bytes) -> Array:
    """A grey JPEG's pixels (h, w) uint8. Raises DeviceError."""
    from PIL import Image

    try:
        picture: Any = Image.open(io.BytesIO(data))
        return np.asarray(picture.convert("L"))
    except (OSError, ValueError) as error:
        raise DeviceError(f"an image of the clip cannot be decoded ({error})") from None
