"""A moving mesh, one file a frame: Wavefront OBJ, and PLY and GLB through trimesh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from devices.files.timing import grid_of
from stream.bounded import reading
from stream.chunk import Array, Samples
from stream.errors import RecordingError
from stream.mesh import Topology
from stream.optional import optional
from stream.recording.series import Series
from stream.tables import read_text

RATE_HZ = 30.0
BY_TRIMESH = (".ply", ".glb")


def read_obj(files: Sequence[Path], rate_hz: float = RATE_HZ, scale: float = 1.0, start_ns: int = 0) -> list[Series]:
    """One stream, called after the first file: the vertices (vertices, 3) of each file in turn, times `scale` in metres.

    Every file holds the same mesh; polygons become fans of triangles; textures and normals are left out. The vertices stay in the file's
    order. Of a GLB file the scene at rest is read, its meshes one after the other. Raises RecordingError.
    """
    frames: list[Samples] = []
    faces: Array = np.empty((0, 3), np.int32)
    for number, path in enumerate(files):
        with reading(path, f"a mesh ({path.suffix.lower() or 'OBJ'})"):
            vertices, mine = _by_trimesh(path) if path.suffix.lower() in BY_TRIMESH else _mesh(path)
        if number and (len(vertices) != len(frames[0]) or not np.array_equal(mine, faces)):
            raise RecordingError(
                f"{path}: is another mesh than {files[0]}: every frame must have the same vertices and faces"
            )
        frames.append(vertices * scale)
        faces = mine
    mesh = Topology(len(frames[0]), faces, files[0].stem)
    time = grid_of(rate_hz, np.arange(len(frames)), start_ns)
    return [Series(files[0].stem, mesh.spec(rate_hz), time, np.array(frames))]


def _mesh(path: Path) -> tuple[Samples, Array]:
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(read_text(path, "OBJ").split("\n"), 1):
        words = line.split()
        try:
            if words[:1] == ["v"]:
                vertices.append([float(word) for word in words[1:4]])
            elif words[:1] == ["f"]:
                corners = [int(word.partition("/")[0]) for word in words[1:]]
                corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                faces += [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]
        except ValueError:
            raise RecordingError(f"{path}: line {number}: {line.strip()[:60]!r} is no vertex or face") from None
    made = np.array(vertices, np.float64)
    if made.ndim != 2 or made.shape[1] != 3 or not len(made) or not np.isfinite(made).all():
        raise RecordingError(f"{path}: holds no vertices with three finite coordinates each")
    triangles = np.array(faces, np.int32).reshape(-1, 3)
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(made)):
        raise RecordingError(f"{path}: a face names a vertex that is not there; there are {len(made)}")
    return made, triangles


def _by_trimesh(path: Path) -> tuple[Samples, Array]:
    trimesh = optional("trimesh", f"{path}: a mesh of this kind", "pip install 'kinegraph[mesh]'", RecordingError)
    scene = trimesh.load_scene(str(path), process=False, maintain_order=True)
    parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    if not parts:
        raise RecordingError(f"{path}: holds no triangles")
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    made = np.concatenate([np.asarray(part.vertices, np.float64) for part in parts])
    if not np.isfinite(made).all():
        raise RecordingError(f"{path}: holds vertices that are not finite")
    return made, np.concatenate([part.faces + n for part, n in zip(parts, first[:-1], strict=True)]).astype(np.int32)
