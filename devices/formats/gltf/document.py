"""A glTF 2.0 file, binary (GLB) or text: its document, its buffers, and the numbers that its accessors name.

Source: Khronos, glTF 2.0 specification. pygltflib was not taken: it turns the document into objects, and leaves accessors, strides, sparse
values and the bounds of buffers, which are most of this file, to its user. It also reads a file before its size can be checked.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.data.bounded import check_size
from kinegraph.stream.errors import RecordingError

MAX_JSON = 64 << 20
KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")


def glb_chunks(data: bytes, path: Path, what: str = "glTF file") -> tuple[dict[str, Any], bytes]:
    """The document of a glTF binary, and the bytes that follow it. Raises RecordingError, or ValueError for a document that is no JSON."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise RecordingError(f"{path}: is not a {what}: it does not begin as a glTF binary does")
    length, kind = struct.unpack_from("<II", data, 12)
    if kind != 0x4E4F534A or length > min(len(data) - 20, MAX_JSON):
        raise RecordingError(f"{path}: is not a {what}: its first chunk is not JSON, or is cut off")
    found = json.loads(data[20 : 20 + length])
    if not isinstance(found, dict) or not isinstance(found.get("nodes"), list):
        raise RecordingError(f"{path}: is not a {what}: it has no nodes")
    rest = data[20 + length :]
    if len(rest) < 8 or rest[4:8] != b"BIN\0":
        return found, b""
    (size,) = struct.unpack_from("<I", rest)
    return found, rest[8 : 8 + size]


def matrix_of(node: dict[str, Any]) -> Samples:
    """Where a node is in its parent, (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), float)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


@dataclass(frozen=True, slots=True)
class Gltf:
    """A document, and the bytes of its buffers."""

    json: dict[str, Any]
    buffers: list[bytes]

    @staticmethod
    def open(path: Path) -> Gltf:
        """A .glb, or a .gltf with what it names in its own folder. Raises RecordingError, ValueError, OSError."""
        data, held = path.read_bytes(), b""
        if data[:4] == b"glTF":
            document, held = glb_chunks(data, path)
        else:
            document = json.loads(data[:MAX_JSON])
        if not isinstance(document, dict) or not str(document.get("asset", {}).get("version", "")).startswith("2."):
            raise RecordingError(f"{path}: is not a file of glTF 2.0")
        if packed := next((one for one in document.get("extensionsRequired", ()) if one in PACKED), None):
            raise RecordingError(f"{path}: its mesh is compressed by {packed}; export it without compression")
        buffers = [
            _bytes_of(buffer, path, held if number == 0 else b"")
            for number, buffer in enumerate(document.get("buffers", ()))
        ]
        return Gltf(document, buffers)

    def numbers(self, accessor: int) -> Array:
        """What an accessor names, (count, width): floats, or whole numbers that are not to be normalised."""
        one = self.json["accessors"][_index(accessor)]
        kind, width, count = np.dtype(KINDS[one["componentType"]]), WIDTHS[one["type"]], _index(one["count"])
        if "bufferView" in one:
            made = self._view(one["bufferView"], one.get("byteOffset", 0), kind, count, width)
        else:
            check_size(count * width * kind.itemsize, sum(map(len, self.buffers)))
            made = np.zeros((count, width), kind)
        if "sparse" in one:
            made = self._sparse(one["sparse"], made)
        if one.get("normalized") and kind.kind in "iu":
            made = np.maximum(made / np.iinfo(kind).max, -1.0)
        return made

    def _view(self, view: int, offset: int, kind: np.dtype[Any], count: int, width: int) -> Array:
        one = self.json["bufferViews"][_index(view)]
        data, size = self.buffers[_index(one["buffer"])], kind.itemsize * width
        start = _index(one.get("byteOffset", 0)) + _index(offset)
        end = min(_index(one.get("byteOffset", 0)) + _index(one["byteLength"]), len(data))
        stride = _index(one.get("byteStride", 0)) or size
        if count and (stride < size or start + (count - 1) * stride + size > end):
            raise ValueError(f"{count} numbers at byte {start} lie beyond the {end} bytes that there are for them")
        if not count:
            return np.zeros((0, width), kind)
        return np.ndarray((count, width), kind, data, start, (stride, kind.itemsize)).copy()

    def _sparse(self, sparse: dict[str, Any], made: Array) -> Array:
        """`made` with some of its rows replaced."""
        count, at, by = _index(sparse["count"]), sparse["indices"], sparse["values"]
        kind = np.dtype(KINDS[at["componentType"]])
        rows = self._view(at["bufferView"], at.get("byteOffset", 0), kind, count, 1)[:, 0]
        made[rows] = self._view(by["bufferView"], by.get("byteOffset", 0), made.dtype, count, made.shape[1])
        return made


def _index(number: Any) -> int:
    """A number of the document that counts something, or says where it is."""
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise ValueError(f"{number!r} stands where a whole number belongs")
    return number


def _bytes_of(buffer: dict[str, Any], path: Path, held: bytes) -> bytes:
    """A buffer's bytes: those `held` in the file itself, written out in its document, or in a file beside it."""
    uri = buffer.get("uri")
    if uri is None:
        data = held
    elif str(uri).startswith("data:"):
        data = base64.b64decode(str(uri).partition(",")[2], validate=True)
    else:
        folder = path.parent.resolve()
        beside = (folder / unquote(str(uri))).resolve()
        if not beside.is_relative_to(folder):
            raise RecordingError(f"{path}: names a file outside its own folder: {uri}")
        if not beside.is_file():
            raise RecordingError(f"{path}: {uri}, which it names, is not beside it")
        data = beside.read_bytes()
    if len(data) < _index(buffer["byteLength"]):
        raise ValueError(f"a buffer of {buffer['byteLength']} bytes has {len(data)}")
    return data
