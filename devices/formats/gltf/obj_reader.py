"""A moving mesh: one file a frame (Wavefront OBJ; PLY through trimesh; glTF), or the animations of a glTF file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.gltf.moving_mesh import RATE_HZ, MovingMesh
from kinegraph.devices.formats.gltf.reader import animated, read_gltf
from kinegraph.devices.formats.timing import grid_of
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.data.tables import read_text
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series
from kinegraph.stream.system.extras import optional

GLTF = (".glb", ".gltf")


def read_obj(
    files: Sequence[Path], rate_hz: float | None = None, scale: float = 1.0, start_ns: int = 0
) -> list[Series]:
    """The vertices (vertices, 3) of moving meshes, times `scale` in metres.

    Every file without an animation is a frame (30 Hz by default) of one stream, called after the first of them; they hold the
    same mesh, and come as `frames_in_order` puts them. Each animation of a glTF file is a stream of its own, called after its file, and
    itself where there are several, at the rate of its keys where these are regular and at least 10 Hz, else at 30 Hz. Polygons become
    fans of triangles; textures and normals are left out. The vertices stay in the file's order. Raises RecordingError.
    """
    made: list[Series] = []
    frames: list[Samples] = []
    faces: Array = np.empty((0, 3), np.int32)
    files = frames_in_order(files)
    first = files[0]
    for path in files:
        moving: MovingMesh | None = None
        with reading(path, f"a mesh ({path.suffix.lower() or 'OBJ'})"):
            if path.suffix.lower() in GLTF:
                moving = read_gltf(path)
                vertices, mine = moving.at(np.zeros(1))[0], moving.faces
            else:
                vertices, mine = _by_trimesh(path) if path.suffix.lower() == ".ply" else _mesh(path)
        if moving and moving.animations:
            made += _animated(path, moving, rate_hz, scale, start_ns)
            continue
        if frames and (len(vertices) != len(frames[0]) or not np.array_equal(mine, faces)):
            raise RecordingError(
                f"{path}: is another mesh than {first}: every frame must have the same vertices and faces"
            )
        first = first if frames else path
        frames.append(vertices * scale)
        faces = mine
    if frames:
        mesh, gltf = Topology(len(frames[0]), faces, first.stem), all(file.suffix.lower() in GLTF for file in files)
        made.append(_series(first.stem, mesh, rate_hz, np.array(frames), start_ns, gltf=gltf))
    return made


def frames_in_order(files: Sequence[Path]) -> list[Path]:
    """Files that a shell listed, called alike but for one number, by that number: frame2 before frame10. Others stay as they are."""
    split = [re.split(r"([0-9]+)", file.name) for file in files]
    if any(len(parts) != len(split[0]) for parts in split) or len({file.parent for file in files}) > 1:
        return list(files)
    differ = [k for k, column in enumerate(zip(*split, strict=True)) if len(set(column)) > 1]
    names = [file.name for file in files]
    bare = [re.sub(r"\W", "", name) for name in names]  # many locales pass over signs
    listed = names == sorted(names) or bare == sorted(bare)
    if len(differ) != 1 or differ[0] % 2 == 0 or not listed:
        return list(files)
    number = {file: int(parts[differ[0]]) for file, parts in zip(files, split, strict=True)}
    return sorted(files, key=lambda file: number[file])


def _animated(path: Path, mesh: MovingMesh, rate_hz: float | None, scale: float, start_ns: int) -> list[Series]:
    """A stream of each animation."""
    topology = Topology(mesh.vertices, mesh.faces, path.stem)
    made: list[Series] = []
    for name, rate, frames in animated(mesh, path, rate_hz):
        stem = path.stem if len(mesh.animations) == 1 else f"{path.stem}.{re.sub('[^A-Za-z0-9_-]+', '_', name)}"
        taken = sum(one.name == stem for one in made)
        name = f"{stem}_{len(made)}" if taken else stem
        made.append(_series(name, topology, rate, frames * scale, start_ns, gltf=True))
    return made


def _series(name: str, mesh: Topology, rate_hz: float | None, frames: Samples, start_ns: int, *, gltf: bool) -> Series:
    """A stream of a mesh; only glTF says which way its axes point."""
    rate, meta = rate_hz or RATE_HZ, {"axes": BODY.facts()} if gltf else {}
    return Series(name, mesh.spec(rate, meta=meta), grid_of(rate, np.arange(len(frames)), start_ns), frames)


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
            raise RecordingError(f"{path}: line {number}: {line.strip()[:60]!r} is not a vertex or face") from None
    made = np.array(vertices, np.float64)
    if made.ndim != 2 or made.shape[1] != 3 or not len(made) or not np.isfinite(made).all():
        raise RecordingError(f"{path}: holds no vertices with three finite coordinates each")
    triangles = np.array(faces, np.int32).reshape(-1, 3)
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(made)):
        raise RecordingError(f"{path}: a face refers to a vertex that does not exist; there are {len(made)}")
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
