"""Meshes: what a stream of vertices says in its spec of how they are joined.

A sample is (vertices, 3) float, in metres. The spec's `meta["mesh"]` holds `name`, `topology` (a hash of the triangles: streams with
the same one are the same mesh, moved differently), `triangles` (how many) and `faces`: the triangles' vertices, (triangles, 3)
little-endian int32, deflated, in base64.
"""

from __future__ import annotations

import binascii
import hashlib
import zlib
from base64 import b64decode, b64encode
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError

MAX_TRIANGLES = 5_000_000


@dataclass(frozen=True, slots=True)
class Topology:
    """How the vertices of a mesh are joined.

    faces   (triangles, 3) int32: numbers of vertices, counter-clockwise seen from outside
    """

    vertices: int
    faces: NDArray[np.int32]
    name: str = ""

    def __post_init__(self) -> None:
        faces = np.ascontiguousarray(self.faces, "<i4")
        object.__setattr__(self, "faces", faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or self.vertices < 1:
            raise ValueError(f"faces of shape {faces.shape}; they must be triangles (triangles, 3)")
        if faces.size and (faces.min() < 0 or faces.max() >= self.vertices):
            raise ValueError(f"a triangle names vertex {faces.max()}; there are {self.vertices}, counted from 0")

    @property
    def hash(self) -> str:
        """16 hexadecimal digits: the same for the same number of vertices and the same triangles in the same order."""
        head = f"{self.vertices} ".encode()
        return hashlib.sha256(head + self.faces.tobytes()).hexdigest()[:16]

    def facts(self) -> dict[str, Any]:
        """What a spec says of this mesh in its `meta`."""
        packed = b64encode(zlib.compress(self.faces.tobytes(), 9)).decode()
        return {"name": self.name, "topology": self.hash, "triangles": len(self.faces), "faces": packed}

    def spec(self, rate_hz: float | None, *, dtype: Any = np.float64, **changes: Any) -> StreamSpec:
        """The spec of a stream of this mesh's vertices; `meta` among the changes is kept beside the mesh."""
        meta = {**changes.pop("meta", {}), "mesh": self.facts()}
        return StreamSpec((self.vertices, 3), np.dtype(dtype), rate_hz, units=("m",), meta=meta, **changes)

    @staticmethod
    def of(spec: StreamSpec, port: str = "in") -> Topology:
        """The mesh of a stream of vertices. Raises InputError for any other stream."""
        try:
            facts = spec.meta["mesh"]
            if spec.is_event or len(spec.shape) != 2 or spec.shape[1] != 3:
                raise ValueError("samples are not (vertices, 3)")
            made = Topology(spec.shape[0], _faces(facts), str(facts["name"]))
            if made.hash != facts["topology"]:
                raise ValueError("the triangles are not those that its hash was made of")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            accepts = "a stream of a mesh's vertices (vertices, 3), with the mesh in its spec"
            raise InputError(port, f"{spec.describe()} ({error})", accepts) from None
        return made


def _faces(facts: Any) -> NDArray[np.int32]:
    count = int(facts["triangles"])
    if not 0 <= count <= MAX_TRIANGLES:
        raise ValueError(f"{count} triangles")
    try:
        inflate = zlib.decompressobj()
        raw = inflate.decompress(b64decode(facts["faces"], validate=True), 12 * count + 1)
    except (zlib.error, binascii.Error) as error:
        raise ValueError(f"its triangles cannot be read: {error}") from None
    if len(raw) != 12 * count:
        raise ValueError(f"{len(raw)} bytes of triangles; {12 * count} are needed")
    return np.frombuffer(raw, "<i4").reshape(count, 3)
