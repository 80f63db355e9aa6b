"""Meshes of other programs: a PLY or GLB file a frame, read through trimesh, as the OBJ files of the same mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.formats.gltf.obj_reader import frames_in_order, read_obj
from kinegraph.devices.formats.gltf.writer import write_mesh
from kinegraph.devices.people.quadruped import topology, walking
from kinegraph.stream.cli import main as cli
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording import Recording
from tests.support.command_line import succeeding

FRAMES = np.array([walking(k / 6) for k in range(6)])
FACES = topology().faces


def ply(path: Path, points: np.ndarray, faces: np.ndarray) -> Path:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [*(f"{x!r} {y!r} {z!r}" for x, y, z in points.tolist()), *(f"3 {a} {b} {c}" for a, b, c in faces.tolist())]
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def glb(path: Path, points: np.ndarray, faces: np.ndarray) -> Path:
    write_mesh(path, faces, np.arange(2) / 30, np.repeat(points[None], 2, axis=0))
    return path


@pytest.mark.parametrize(("write", "suffix", "within"), [(ply, "ply", 1e-6), (glb, "glb", 1e-6)])
def test_a_file_a_frame_becomes_a_recording_of_the_same_mesh(write, suffix: str, within: float, tmp_path: Path) -> None:
    pytest.importorskip("trimesh", reason="trimesh is not installed (extra mesh)")
    files = [write(tmp_path / f"walk{k}.{suffix}", points, FACES) for k, points in enumerate(FRAMES)]
    with succeeding():
        cli.call("files import", [*map(str, files), "--rate", "24", "-o", str(tmp_path / "walk.mcap")])
    with Recording.open(tmp_path / "walk.mcap") as recording:
        spec, (_, rows) = recording.streams["walk0"].spec, recording.read("walk0")
    assert spec.rate_hz == 24.0 and spec.meta["mesh"]["topology"] == topology().hash  # the vertices keep their order
    assert np.abs(rows - FRAMES).max() < within


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (
            ["walk1.obj", "walk10.obj", "walk2.obj"],
            ["walk1.obj", "walk2.obj", "walk10.obj"],
        ),  # as a shell lists walk*.obj
        (
            ["walk10.obj", "walk1.obj", "walk2.obj"],
            ["walk1.obj", "walk2.obj", "walk10.obj"],
        ),  # in most languages' order
        (["v2_10.obj", "v2_9.obj"], ["v2_9.obj", "v2_10.obj"]),
        (["walk2.obj", "walk10.obj", "walk1.obj"], ["walk2.obj", "walk10.obj", "walk1.obj"]),  # an order of one's own
        (["run10.obj", "walk2.obj"], ["run10.obj", "walk2.obj"]),
        (["a.obj", "b.obj"], ["a.obj", "b.obj"]),
        (["a1_10.obj", "a2_2.obj"], ["a1_10.obj", "a2_2.obj"]),  # which number counts is not known
    ],
)
def test_frames_that_a_shell_lists_come_by_their_numbers(given: list[str], read: list[str]) -> None:
    assert [path.name for path in frames_in_order([Path("mesh", name) for name in given])] == read


def test_a_sequence_without_leading_zeros_plays_in_order(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0, k] for k in range(1, 12)])
    for k, point in enumerate(points, 1):
        (tmp_path / f"f{k}.obj").write_text(
            "".join(f"v {x} {y} {z}\n" for x, y, z in (point, point + 1, point + 2)) + "f 1 2 3\n"
        )
    (series,) = read_obj(sorted(tmp_path.glob("f*.obj")))
    assert series.name == "f1" and (np.diff(np.asarray(series.data)[:, 0, 2]) == 1).all()


def test_what_is_no_mesh_or_another_one_is_named(tmp_path: Path) -> None:
    pytest.importorskip("trimesh", reason="trimesh is not installed (extra mesh)")
    one, other = ply(tmp_path / "a.ply", FRAMES[0], FACES), ply(tmp_path / "b.ply", FRAMES[1], FACES[:-1])
    with pytest.raises(RecordingError, match=r"b\.ply: is another mesh"):
        read_obj([one, other])
    for name, text in (("c.ply", "ply\nformat ascii 1.0\nelement vertex 3\n"), ("d.glb", "glTF of nothing")):
        (tmp_path / name).write_text(text)
        with pytest.raises(RecordingError, match=name):
            read_obj([tmp_path / name])
